"""Random numbers and packed values bit for bit against numpy, and sampled distributions against their closed forms."""

import numpy as np
import pytest
from oracles.encodings import (
    RGB9E5_MAX,
    decode_rgb9e5,
    encode_rgb9e5,
    pcg4d,
    pcg_hash,
    pcg_output,
    pcg_step,
    rgb9e5_step,
)
from support.seeded_bugs import Bug, bug_tests, with_shaders
from support.statistics import sidak, uniform_p

# ---- generators -------------------------------------------------------------------------------------


def test_generators(shaders):
    words = np.random.default_rng(1).integers(0, 2**32, (1000, 4), dtype=np.uint32)
    words[:3] = [[0] * 4, [0xFFFFFFFF] * 4, [1] * 4]
    count = len(words)
    outputs = {"hashes": 6 * count, "numbers": 8 * count, "floats": 8 * count, "ranged": 8 * count}
    out = shaders.run("test/random", count, {"words": words}, outputs)
    state = pcg4d(words)[:, 0]
    hashes = np.column_stack([pcg_hash(words[:, 0]), pcg4d(words), state])
    assert (out["hashes"].reshape(-1, 6) == hashes).all()
    for k in range(8):
        state = pcg_step(state)
        number = pcg_output(state).astype(np.uint64)
        assert (out["numbers"][k::8] == number).all()
        assert (out["floats"][k::8] == (number >> 8) / 2**24).all()
        assert (out["ranged"][k::8] == number * words[:, 1] >> 32).all()


# ---- distributions, mapped back to the unit square, where they must be uniform ----------------------

COUNT = 1_000_000
CONES = [2.0, 1.0, 0.01, 1.1e-5, 1.25e-11]  # 1 - cos: a sphere, a hemisphere, ..., the sun, the smallest light
AXES = [(0, 0, 1), (0, 0, -1), (0.6, -0.48, 0.64), (1e-5, 0, -1)]


def draw(shaders, kind, axis=(0.0, 0.0, 1.0), cone=1.0, count=COUNT):
    axis = np.array(axis, np.float32) / np.float32(np.linalg.norm(axis))
    words = np.concatenate([np.array([kind, 7], np.uint32), np.array([*axis, cone], np.float32).view(np.uint32)])
    draws = shaders.run("test/distributions", count, {"parameters": words}, {"draws": count})["draws"]
    assert np.isfinite(draws).all()
    return draws.astype(np.float64), axis.astype(np.float64)


def turns(x, y):
    return np.arctan2(y, x) / (2 * np.pi) % 1


def test_disk(shaders):
    d, _ = draw(shaders, 0)
    assert uniform_p(d[:, 0] ** 2 + d[:, 1] ** 2, turns(d[:, 0], d[:, 1])) > sidak(0.01, 8)


def test_hemispheres(shaders):
    for kind, power in ((1, 2), (2, 1)):
        d, _ = draw(shaders, kind)
        assert np.abs(np.linalg.norm(d, axis=1) - 1).max() < 1e-6
        assert (d[:, 2] > 0).all() or kind == 2
        assert uniform_p(d[:, 2] ** power, turns(d[:, 0], d[:, 1])) > sidak(0.01, 8)


def test_barycentrics(shaders):
    d, _ = draw(shaders, 4)
    rest = 1 - d[:, 0] - d[:, 1]
    assert rest.min() > -1e-6
    assert uniform_p((1 - rest) ** 2, d[:, 0] / np.maximum(1 - rest, 1e-12)) > sidak(0.01, 8)


@pytest.mark.parametrize(("cone", "axis"), [*((cone, AXES[2]) for cone in CONES), *((1.1e-5, a) for a in AXES)])
def test_cone(shaders, cone, axis):
    d, axis = draw(shaders, 3, axis, cone, COUNT // 4)
    assert np.abs(np.linalg.norm(d, axis=1) - 1).max() < 1e-6
    apart = d - axis
    share = (apart**2).sum(axis=1) / 2 / cone  # (1 - cos) / (1 - cos of the half angle)
    assert share.max() < 1 + 1e-6 + 6e-7 / np.sqrt(2 * cone)  # a component's rounding against the cone's radius
    first = np.cross(axis, (1, 0, 0) if abs(axis[0]) < 0.9 else (0, 1, 0))
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    if cone > 1e-8:
        assert uniform_p(np.minimum(share, 1), turns(apart @ first, apart @ second)) > sidak(0.01, 20)
    else:
        assert abs(share.mean() - 0.5) < 0.02


# ---- packed values: bit for bit where arithmetic is exact, within a step of the format elsewhere ----

EXPOSURE = 0.25


def packing_inputs():
    rng, count = np.random.default_rng(3), 20_000
    colors = (rng.random((count, 3)) * 2.0 ** rng.uniform(-20, 17, (count, 1))).astype(np.float32)
    edges = [0, 1e-9, 2.0**-24, 2.0**-16, 1, 511.5 / 512, 511.75 / 512, 2, 3.9999, 65408, 65504, 1e9]
    colors[: len(edges)] = np.array(edges, np.float32)[:, None]
    colors[len(edges) : 2 * len(edges), 0] = edges
    directions = rng.normal(size=(count, 3))
    directions[:10] = [*np.eye(3), *-np.eye(3), [1, 1, 0], [-1, 1, 0], [0, -1, -1], [1e-7, -1e-7, -1]]
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    values = rng.uniform(-0.1, 1.1, count).astype(np.float32)
    values[:256] = np.arange(256) / 255
    return colors, directions, values


def test_packings(shaders):
    colors, directions, values = packing_inputs()
    count = len(colors)
    given = {"colors": colors, "directions": directions, "values": values}
    out = shaders.run("test/packing", count, given, {"packed": 5 * count, "unpacked": 5 * count})
    packed, unpacked = out["packed"].reshape(-1, 5), out["unpacked"].reshape(-1, 5, 4).astype(np.float64)
    step = rgb9e5_step(packed)

    assert (packed[:, 0] == encode_rgb9e5(colors)).all()
    assert (unpacked[:, 0, :3] == decode_rgb9e5(packed[:, 0])).all()
    assert (np.abs(unpacked[:, 0, :3] - np.clip(colors, 0, RGB9E5_MAX)) <= 0.5 * step[:, :1]).all()

    logarithms = np.log2(1 + colors.astype(np.float64) * EXPOSURE)
    decoded = np.log2(1 + unpacked[:, 1, :3] * EXPOSURE)
    assert (np.abs(decoded - logarithms) <= 0.505 * step[:, 1:2] + 4e-6).all()

    for column, bound in ((2, 7e-5), (3, 1.1e-3)):
        assert np.linalg.norm(unpacked[:, column, :3] - directions, axis=1).max() < bound
        assert (unpacked[:6, column, :3] == directions[:6]).all(), "the axes are exact"

    exact = np.clip(values.astype(np.float64), 0, 1) * 255
    between = np.abs(exact % 1 - 0.5) < 1e-4
    assert ((packed[:, 4] == np.floor(exact + 0.5)) | between).all()
    assert (packed[:256, 4] == np.arange(256)).all()
    assert np.abs(unpacked[:, 4, 0] - packed[:, 4] / 255).max() < 1e-7


RANDOM, PACKING = "common/random.glsl", "common/packing.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "generators": (with_shaders(test_generators), Bug("common/hash.glsl", "pcg", "return correct(v) ^ (v & 1u);")),
        "ranges": (with_shaders(test_generators), Bug(RANDOM, "rand_range_u", "return correct(max(n, 1u) - 1u, rng);")),
        "disks": (with_shaders(test_disk), Bug(RANDOM, "sample_disk", "return correct(vec2(u.x * u.x, u.y));")),
        "hemispheres": (
            with_shaders(test_hemispheres),
            Bug(RANDOM, "sample_uniform_hemisphere", "return sample_cosine_hemisphere(u);"),
        ),
        "barycentrics": (
            with_shaders(test_barycentrics),
            Bug(RANDOM, "sample_triangle_barycentrics", "return correct(vec2(u.x * u.x, u.y));"),
        ),
        "cones": (
            with_shaders(test_cone, 0.01, (0, 0, 1)),
            Bug(RANDOM, "sample_cone", "return correct(axis, 2.0 * one_minus_cos_half_angle, u);"),
        ),
        "packing of numbers": (
            with_shaders(test_packings),
            Bug(PACKING, "pack_rgb9e5", "return correct(color * 0.999);"),
        ),
        "packing of directions": (with_shaders(test_packings), Bug(PACKING, "octahedral_wrap", "return v;")),
    },
    quick=("disks", "packing of directions"),
)
