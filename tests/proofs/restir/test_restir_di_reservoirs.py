"""Reservoirs of direct light by enumeration: over all random outcomes, the mean of a merge is exactly the sum."""

import functools
import itertools

import numpy as np
import pytest
from oracles.encodings import pcg_hash, pcg_step
from scipy import stats
from support.seeded_bugs import Bug, bug_tests, with_shaders

NEITHER = 0xFFFFFFFF
SIZE = (13, 9)  # neither side divides by 4
MERGE = np.dtype(
    [("confidences", "<f4", 2), ("weights", "<f4", 2), ("here", "<f4", 2), ("there", "<f4", 2), ("rng", "<u4")]
)
STREAM = np.dtype([("weights", "<f4", 4), ("rng", "<u4")])


def run(shaders, merges=(), streams=()):
    merges = np.asarray(merges, MERGE) if len(merges) else np.zeros(1, MERGE)
    streams = np.asarray(streams, STREAM) if len(streams) else np.zeros(1, STREAM)
    pixels = 16 * SIZE[0] * SIZE[1]
    return shaders.run(
        "test/reservoirs",
        max(len(merges), len(streams), pixels),
        {"merges": merges, "streams": streams},
        {"merged": len(merges), "chosen": len(streams), "permuted": pixels},
        uniforms={"camera.size": SIZE},
    )


def initial_outcomes(targets, candidates):
    """All outcomes of RIS over equally likely lights: a list of (light, probability, contribution weight)."""
    count = len(targets)
    outcomes = []
    for drawn in itertools.product(range(count), repeat=candidates):
        weights = targets[list(drawn)]
        total = weights.sum()
        if total == 0:
            outcomes.append((None, count**-candidates, 0.0))
        for light in set(drawn) if total > 0 else ():
            chance = sum(w for d, w in zip(drawn, weights, strict=True) if d == light) / total
            if chance > 0:
                outcomes.append((light, chance * count**-candidates, total * count / candidates / targets[light]))
    return outcomes


# Targets of each light at this pixel and at the other one. In "gone" the last light was removed, in "new" the first one
# was added; in "apart" the two pixels have no light in common.
CASES = {
    "alike": ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
    "unlike": ([1.0, 0.2, 3.0], [5.0, 2.0, 0.1]),
    "zeros": ([1.0, 0.0, 3.0], [0.0, 2.0, 0.5]),
    "apart": ([1.0, 2.0, 0.0], [0.0, 0.0, 4.0]),
    "gone": ([1.0, 2.0, 0.0], [1.0, 2.0, 8.0]),
    "new": ([4.0, 1.0, 2.0], [0.0, 1.0, 2.0]),
    "dark there": ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]),
    "dark here": ([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]),
}
CONFIDENCES = [(1.0, 20.0), (1.0, 1.0), (1.0, 0.0), (21.0, 3.0)]


def check_merge(shaders, name):
    """The mean of target times weight over all outcomes is the sum of targets, with and without reuse."""
    for confidences in CONFIDENCES:
        here, there = (np.array(targets) for targets in CASES[name])
        cases, chances = [], []
        for (a, chance_a, weight_a), (b, chance_b, weight_b) in itertools.product(
            initial_outcomes(here, 2), initial_outcomes(there, 3)
        ):
            at_here, at_there = (
                tuple(0.0 if light is None else targets[light] for light in (a, b)) for targets in (here, there)
            )
            cases.append((confidences, (weight_a, weight_b), at_here, at_there, len(cases)))
            chances.append(chance_a * chance_b)
        cases = np.array(cases, MERGE)
        out = run(shaders, cases)["merged"]
        assert np.isfinite(out["weight"]).all()
        assert (out["confidence"] == sum(confidences)).all(), "finding nothing counts as well"
        assert abs(sum(chances) - 1) < 1e-9
        target = np.select([out["choice"] == 1, out["choice"] == 2], [cases["here"][:, 0], cases["here"][:, 1]], 0.0)
        assert (out["weight"][target == 0] == 0).all()
        mean = (np.array(chances) * target * out["weight"]).sum()
        assert abs(mean - here.sum()) <= 1e-5 * here.sum() + 1e-7, (name, confidences)


def check_choices(shaders):
    """How often each of two samples is chosen, over many random numbers, and the weight that it then gets."""
    count = 40_000
    case = ((3.0, 5.0), (2.0, 0.7), (1.5, 2.5), (0.4, 3.0))
    cases = np.array([(*case, seed) for seed in range(count)], MERGE)
    out = run(shaders, cases)["merged"]
    (c1, c2), (w1, w2), (h1, h2), (t1, t2) = case
    first = c1 * h1 / (c1 * h1 + c2 * t1) * h1 * w1
    second = c2 * t2 / (c1 * h2 + c2 * t2) * h2 * w2
    picked = out["choice"] == 2
    assert stats.binomtest(int(picked.sum()), count, second / (first + second)).pvalue > 1e-4
    assert set(out["choice"]) == {1, 2}
    np.testing.assert_allclose(out["weight"], (first + second) / np.where(picked, h2, h1), rtol=1e-5)


def check_streams(shaders):
    """The choice follows from the generator's numbers, one by one; weights of 0 are never chosen."""
    random = np.random.default_rng(4)
    streams = np.zeros(5000, STREAM)
    streams["weights"] = random.random((5000, 4)) * (random.random((5000, 4)) < 0.6)
    streams["rng"] = random.integers(0, 2**32, 5000, np.uint64)
    out = run(shaders, streams=streams)["chosen"]
    np.testing.assert_allclose(out["sum"], streams["weights"].sum(axis=1), rtol=1e-6)
    state = streams["rng"]
    total = np.zeros(5000)
    margin = np.ones(5000)
    expected = np.full(5000, NEITHER)
    for k, weight in enumerate(streams["weights"].T.astype(np.float64)):
        u, state = (pcg_hash(state) >> 8) * 2.0**-24, pcg_step(state)
        total += weight
        margin = np.where(weight > 0, np.minimum(margin, np.abs(u * total - weight)), margin)
        expected = np.where(u * total < weight, k, expected)
    certain = margin > 1e-6
    assert certain.mean() > 0.95
    assert (out["index"] == expected)[certain].all()
    nothing = streams["weights"].sum(axis=1) == 0
    assert nothing.any()
    assert (out["index"][nothing] == NEITHER).all()


def check_permutation(shaders):
    """The permutation is its own inverse for each of the 16 shifts, and no pixel leaves the picture or wraps around."""
    width, height = SIZE
    y, x = np.mgrid[:height, :width]
    pixels = np.stack([x, y], axis=-1)
    moved = run(shaders)["permuted"].reshape(16, height, width, 2)
    assert (moved >= 0).all()
    assert (moved < SIZE).all()
    inside = np.s_[3 : height - 3, 3 : width - 3]
    for to in moved:
        assert (to[to[..., 1], to[..., 0]] == pixels).all()
        apart = np.abs(to - pixels).max(axis=-1)
        assert apart.max() == 3
        assert (apart[inside] > 0).all()
    assert len(np.unique(moved, axis=0)) == 16, "the blocks lie elsewhere in other frames"


def test_merge(shaders):
    for name in CASES:
        check_merge(shaders, name)


@pytest.mark.parametrize("check", [check_choices, check_streams, check_permutation])
def test_choice(shaders, check):
    check(shaders)


SHARE = functools.partial(Bug, "passes/solari019/restir_di/reservoir.glsl", "merge_share")
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "merge: weights ignore targets": (
            with_shaders(check_merge, "zeros"),
            SHARE("return correct(confidences, vec2(1.0));"),
        ),
        "choices: confidence ignored": (with_shaders(check_choices), SHARE("return correct(vec2(1.0), targets);")),
        "streams: latest preferred": (
            with_shaders(check_streams),
            Bug(
                "common/random.glsl",
                "choose_weighted",
                "weight_sum += weight; return rand_f(rng) * rand_f(rng) * weight_sum < weight;",
            ),
        ),
        "permutation: no shift back": (
            with_shaders(check_permutation),
            Bug(
                "passes/reuse.glsl",
                "permute_pixel",
                "ivec2 shift = ivec2(random & 3u, random >> 2u & 3u); "
                "ivec2 partner = (pixel + shift) ^ 3; return is_inside(partner, camera.size) ? partner : pixel;",
            ),
        ),
    },
    quick=("merge: weights ignore targets",),
)
