"""The Sobol sequence against generator matrices, the laws of Owen's scrambling, and independent seeds."""

from math import comb

import numpy as np
import pytest
from support.seeded_bugs import Bug, bug_tests, with_shaders
from support.statistics import chi_squared_p, sidak

BITS = 32
ALPHA = 1e-4  # of each test; the seeds are fixed


def ask(shaders, indices, seeds):
    """The points (N, 2), the indices scrambled by the seeds, and the second dimension of the indices."""
    asked = np.stack(np.broadcast_arrays(indices, seeds), axis=-1).astype(np.uint32).reshape(-1, 2)
    count = len(asked)
    out = shaders.run("test/sobol", count, {"asked": asked}, {"points": count, "parts": count})
    return out["points"].reshape(count, 2).astype(np.float64), *out["parts"].reshape(count, 2).T


def generated(indices, dimension):
    """A dimension (0 or 1) of the unscrambled sequence as 32 bits, by its generator matrix over the integers modulo 2.

    Digit r of a point is the sum of the matrix's row r times the index's digits, lowest first. The matrices are the
    identity, and Pascal's triangle, which the primitive polynomial of degree 0 gives (Burley 2020, section 2).
    """
    matrix = (
        np.array([[comb(column, row) if dimension else row == column for column in range(BITS)] for row in range(BITS)])
        % 2
    )
    digits = (np.asarray(indices, np.uint64)[:, None] >> np.arange(BITS, dtype=np.uint64)) & np.uint64(1)
    found = digits.astype(np.int64) @ matrix.T.astype(np.int64) % 2
    return (found.astype(np.uint64) << np.arange(BITS - 1, -1, -1, dtype=np.uint64)).sum(axis=1).astype(np.uint32)


def check_second_dimension(shaders):
    """All bits are those of the generator matrix."""
    indices = np.concatenate([np.arange(4096), np.random.default_rng(1).integers(0, 2**32, 4096)])
    _, _, found = ask(shaders, indices, 0)
    np.testing.assert_array_equal(found, generated(indices, 1))


def first_difference(a, b):
    """The place of the highest bit that differs, from 0 for the highest of all."""
    return BITS - 1 - np.floor(np.log2((a ^ b).astype(np.float64))).astype(int)


def check_nested(shaders):
    """Scrambling keeps the place of the first bit in which two numbers differ: each bit's flip depends on higher bits.
    Flips are fair, and those of one place below different higher bits are independent."""
    random = np.random.default_rng(2)
    a, seeds = random.integers(0, 2**32, (2, 1 << 16), dtype=np.uint32)
    place = random.integers(0, BITS, len(a))
    low = (np.uint64(1) << (BITS - 1 - place).astype(np.uint64)).astype(np.uint32)
    b = (a ^ low ^ (random.integers(0, 2**32, len(a), dtype=np.uint32) & (low - 1))).astype(np.uint32)
    (_, left, _), (_, right, _) = ask(shaders, a, seeds), ask(shaders, b, seeds)
    assert (left != right).all()
    np.testing.assert_array_equal(first_difference(left, right), place)
    for at in range(12):
        bit = BITS - 1 - at
        # The flips at one place of two numbers that differ one bit above it, or elsewhere above it.
        above = a ^ np.uint32(1 << (bit + 1 + int(random.integers(0, at)))) if at else a
        flips = [(ask(shaders, given, seeds)[1] ^ given) >> bit & 1 for given in (a, above)]
        cells = np.bincount(flips[0] + 2 * flips[1], minlength=4)
        expected = [0.5, 0, 0, 0.5] if at == 0 else [0.25] * 4
        p_value = chi_squared_p(cells, len(a) * np.array(expected))
        assert p_value > sidak(ALPHA, 12), (at, cells, p_value)


def check_intervals(shaders):
    """Each aligned block of 2^m points has one point in every elementary interval of area 2^-m."""
    seeds = np.random.default_rng(3).integers(0, 2**32, 16)
    for m in range(11):
        blocks = np.array([0, 1, 2, 5, 1000, 2 ** (32 - m) - 1])
        indices = (blocks[:, None] << m) + np.arange(1 << m)
        points, _, _ = ask(shaders, indices[None], seeds[:, None, None])
        points = points.reshape(len(seeds) * len(blocks), 1 << m, 2)
        assert points.min() >= 0
        assert points.max() < 1
        for k in range(m + 1):
            cells = (points * (1 << k, 1 << (m - k))).astype(int)
            found = np.sort(cells[..., 0] << (m - k) | cells[..., 1], axis=-1)
            assert (found == np.arange(1 << m)).all(), (m, k)


def check_uniform(shaders):
    """A point of a random seed is uniformly distributed, and so is the pair of one index's points of two seeds."""
    count, seeds = 1 << 18, np.random.default_rng(4).permutation(1 << 19)
    for index in (0, 1, 7, 31, 100_000, 2**32 - 1):
        first, second = (ask(shaders, index, part)[0] for part in (2 * seeds[:count], 2 * seeds[:count] + 1))
        fine = (first * 64).astype(int) @ (64, 1)
        pairs = (np.hstack([first, second]) * 4).astype(int) @ (64, 16, 4, 1)
        for cells, number in ((fine, 4096), (pairs, 256)):
            p_value = chi_squared_p(np.bincount(cells, minlength=number), np.full(number, count / number))
            assert p_value > sidak(ALPHA, 12), (index, number, p_value)


def check_independent(shaders):
    """The points of two seeds, index by index, are as little correlated as shuffled blocks of 2^m points can be."""
    seeds = np.random.default_rng(5).integers(0, 2**31, 2048) * 2
    for m in (3, 5, 8):
        indices = np.arange(1 << m)
        first, second = (ask(shaders, indices, s[:, None])[0].reshape(-1, 1 << m, 2) - 0.5 for s in (seeds, seeds + 1))
        products = 12 * np.einsum("sia,sib->sab", first, second) / (1 << m)
        error = products.std(axis=0) / len(seeds) ** 0.5
        assert (np.abs(products.mean(axis=0)) < 5 * error).all(), (m, products.mean(axis=0) / error)
        # Independent points would give 1; a nested shuffling gives at most 2, one that is equal for all seeds 2^m.
        assert ((1 << m) * (products**2).mean(axis=0) < 3).all(), (m, (1 << m) * (products**2).mean(axis=0))


CHECKS = (check_second_dimension, check_nested, check_intervals, check_uniform, check_independent)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_sobol(shaders, check):
    check(shaders)


SOBOL = "common/sobol.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "second dimension": (
            with_shaders(check_second_dimension),
            Bug(SOBOL, "sobol_second_dimension", "return index;"),
        ),
        "nested": (with_shaders(check_nested), Bug(SOBOL, "owen_scramble", "return bits ^ seed;")),
        "intervals": (
            with_shaders(check_intervals),
            Bug(SOBOL, "owen_scramble", "return bitfieldReverse(correct(bitfieldReverse(bits), seed));"),
        ),
        "uniform": (
            with_shaders(check_uniform),
            Bug(SOBOL, "sobol_point", "return correct(index, seed) * vec2(0.5, 1.0);"),
        ),
        "independent": (
            with_shaders(check_independent),
            Bug(SOBOL, "sobol_point", "return correct(index, seed / 2u);"),
        ),
    },
    quick=("second dimension",),
)
