"""Light tiles: their samples against numpy, the distribution and packing of these, and direct light that uses them."""

from __future__ import annotations

import math
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import pytest
from oracles.encodings import decode_octahedral, decode_rgb9e5, pcg_hash, pcg_step
from oracles.light import floor_scene, sun_radiance
from oracles.rays import camera_rays
from scipy import stats
from support.frames import LIGHT_OFF, direct_renderer, make_renderer, material_records, run_brdf
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require, seeded
from support.statistics import chi_squared_p, standard_deviations

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.bound.lights.light_leaves import EQUAL_SHARE
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb
from solari_vk.scene.matrices import transform_points

FILE = "passes/solari019/light_tiles/light_tiles.glsl"
_0_17, _0_18 = ("Solari in Bevy 0.17", "Presampling Lights"), ("Solari in Bevy 0.18", "Energy Loss Bug")
ENCODED = Rule("packed radiance from 1e-4 to 1e9 times white is exact within half a step of log2 rgb9e5", *_0_18)
SUN = Rule("a sun of 100,000 lux isn't clipped at EV100 9.7", *_0_18)
BLACK = Rule("a color channel of 0 stays 0", *_0_18)
CHOICE = Rule("lights are chosen by power, one half equally often, and their triangles by area")
UNIQUE = Rule("the tiles of four frames hold no sample twice", *_0_17)
SCROLL = Rule("samples are uncorrelated within tiles, between tiles and between frames", *_0_17)
EVERYWHERE = Rule("pixels choose among all samples of a tile and among all tiles, equally often", *_0_17)
CONTRIBUTION = Rule("a packed sample lights a floor as the light itself does", *_0_17)
NOISE = Rule("choosing by tiles is no noisier than resolving each candidate")
_MAX_Z = NormalDist().inv_cdf(0.9999)
COLOR, SATURATED = np.array((1.0, 0.3, 0.0)), np.array((1.0, 0.5, 5e-4))
# Radiance of the lamps (16, 3) in units of white.
EXPOSED = np.geomspace(1e-4, 1e9, 16)[:, None] * np.where(np.arange(16)[:, None] % 2, SATURATED, COLOR)
BALL = 10.0
EV100 = 9.7
LUX = 100_000.0
SUN_ANGLE = 0.0093
ALONE = {**LIGHT_OFF, "di": True, "di_temporal": False, "di_spatial": False}


def half_step(colors):
    """Half of the distance (N, 1) between neighbors in rgb9e5 around colors (N, 3)."""
    _, exponent = np.frexp(colors.max(axis=-1, keepdims=True))  # of a mantissa from 1/2 to 1
    return np.ldexp(1.0, np.maximum(exponent - 1, -16) - 9)


def step_and_rounding(logarithms):
    """The error that packing may add to log2(1 + x) (N, 3): half a step, and Vulkan's tolerances."""
    return half_step(logarithms) + np.maximum(2.0**-21 + 2.0**-23, 2.0**-21 * logarithms)


class LightSamples(NamedTuple):
    """Decoded samples; `position` is a direction where `directional`, and radiance is in units of white."""

    position: np.ndarray
    normal: np.ndarray
    exposed: np.ndarray
    inverse_area_pdf: np.ndarray
    directional: np.ndarray


def decode_samples(packed):
    """Records (N,) of a renderer's `light_tiles`, whose radiance is log2(1 + radiance * exposure)."""
    return LightSamples(
        packed["world_position"].astype(np.float64),
        decode_octahedral(packed["world_normal"]),
        np.exp2(decode_rgb9e5(packed["radiance"])) - 1,
        packed["inverse_area_pdf"].astype(np.float64),
        packed["kind"] == KIND_INDEX["directional"],
    )


def receive(samples, points):
    """Directions (N, 3) from points (N, 3) to the samples, and the irradiance (N, 1) of samples of radiance 1.

    The irradiance includes the inverse pdf, but not the cosine at the points."""
    to_light = samples.position - np.where(samples.directional[:, None], 0, points)
    squared = (to_light**2).sum(axis=-1, keepdims=True)
    wi = to_light / np.sqrt(squared)
    cosine = np.maximum(-(wi * samples.normal).sum(axis=-1, keepdims=True), 0)
    return wi, cosine / squared * samples.inverse_area_pdf[:, None]


def lamps_above(exposed, lux=LUX, angle=SUN_ANGLE):
    """A white floor under a grid of lamps of radiance `exposed` (N, 3), an emissive ball and the sun, in this order."""
    scene = floor_scene(matte(1.0))
    scene.camera.ev100 = EV100
    scene.add(sv.DirectionalLight(direction=rgb((0.3, -1, 0.2)), illuminance=lux, angular_diameter=angle))
    for index, color in enumerate(exposed / scene.camera.exposure):
        at = (0.8 * (index % 4) - 1.2, 4.0, 0.8 * (index // 4) - 1.2)
        scene.add(shapes.quad(at, (0.1, 0, 0), (0, 0, 0.1)), lamp(color))
    scene.add(shapes.sphere(0.2, 8), lamp(BALL / scene.camera.exposure), place(1.0, (0, 5, 0)))
    return scene


def take_tiles(renderer, frames=1):
    """The light samples, their packed records, (frames, tiles, samples per tile) each, and the lights' probabilities,
    as the page of solari_vk/bound/lights/light_list.py says."""
    taken = []
    for _ in range(frames):
        frame = renderer.render()
        taken.append([frame["light_tile_samples"], frame["light_tiles"]])
    shape = frames, -1, renderer.settings.light_tile_samples
    named, packed = (np.stack(of).reshape(shape) for of in zip(*taken, strict=True))
    powers = renderer.binder.lights.powers
    return named, packed, (1 - EQUAL_SHARE) * powers / powers.sum() + EQUAL_SHARE / len(powers)


def triangles_of(mesh):
    """A mesh's triangles (N, 3, 3) in the order of upload, and the share of each in its area in object space."""
    corners = mesh.positions[mesh.triangles]
    corners = corners[spatial_order(corners.min(axis=1), corners.max(axis=1))].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return corners, areas / areas.sum()


def measure_tiles(device):
    """Measures the samples of four frames."""
    scene = lamps_above(EXPOSED)
    with make_renderer(device, scene, (8, 8), **LIGHT_OFF) as renderer:
        named, packed, probabilities = take_tiles(renderer, 4)
    yield from _measure_packing(named.ravel(), packed.ravel(), scene.camera.exposure)
    shares = [np.full(2, 0.5)] * len(EXPOSED) + [triangles_of(shapes.sphere(0.2, 8))[1], np.ones(1)]
    yield from _measure_choice(named, probabilities, shares)


def _measure_packing(named, packed, exposure):
    """Compares packed records with the lights of the scene."""
    light, count = named["light_index"], len(EXPOSED) + 2
    sun = sun_radiance(LUX, SUN_ANGLE) * exposure
    exposed = np.concatenate([EXPOSED, [(BALL,) * 3, (sun,) * 3]])[light]
    stored, expected = decode_rgb9e5(packed["radiance"]), np.log2(1 + exposed)
    error = (np.abs(stored - expected) / step_and_rounding(expected)).max()
    yield Measurement(ENCODED, float(error), 1.0, "of half a step")
    samples = decode_samples(packed)
    error = np.abs(samples.exposed[light == count - 1] / sun - 1).max()
    bar = 2 ** half_step(np.log2([[1 + sun]])).item() - 1
    yield Measurement(SUN, float(error), bar, "relative error", f"{sun:.3g} times white")
    yield Measurement(BLACK, float((samples.exposed[exposed == 0] != 0).sum()), 0.0, "lit")


def _measure_choice(named, probabilities, shares):
    """Tests whether lights, triangles and random numbers are chosen independently and with the right probabilities."""
    first = np.cumsum([0, *(len(of) for of in shares)])
    observed = np.bincount((first[named["light_index"]] + named["part"]).ravel(), minlength=first[-1])
    expected = named.size * np.concatenate([p * of for p, of in zip(probabilities, shares, strict=True)])
    z = standard_deviations(chi_squared_p(observed, expected))
    yield Measurement(CHOICE, z, _MAX_Z, "standard deviations")
    yield Measurement(UNIQUE, float(named.size - len(np.unique(named))), 0.0, f"of {named.size:,} again")
    seeds = named["seed"] / 2.0**32 - 0.5
    pairs = {
        "places": (seeds[..., :-1], seeds[..., 1:]),
        "tiles": (seeds[:, :-1], seeds[:, 1:]),
        "frames": (seeds[:-1], seeds[1:]),
        "scrolled": (seeds[:-1, :, 1:], seeds[1:, :, :-1]),
    }
    for name, (a, b) in pairs.items():
        z = abs(float((a * b).sum())) / math.sqrt(float((a**2).sum() * (b**2).sum()) / a.size)
        yield Measurement(SCROLL, z, _MAX_Z, "standard deviations", name)


def measure_contribution(device):
    """Compares ReSTIR DI with one candidate, which shades with the light itself, with the packed record's light."""
    scene, size = lamps_above(EXPOSED), (32, 32)
    with make_renderer(device, scene, size, **ALONE, di_candidates=1) as renderer:
        named, packed = (taken.ravel() for taken in take_tiles(renderer)[:2])
        reservoirs, lit = renderer["di_reservoirs"].ravel(), renderer["di_diffuse"].reshape(-1, 3).astype(np.float64)
    there = lit.max(axis=-1) > 0
    place_of = {sample.tobytes(): index for index, sample in enumerate(named)}
    chosen = decode_samples(packed[[place_of[r.tobytes()] for r in reservoirs["light_sample"][there]]])
    origins, directions = (rays.reshape(-1, 3)[there] for rays in camera_rays(scene.camera, *size))
    points = origins - directions * (origins[:, 1:2] / directions[:, 1:2])
    wi, share = receive(chosen, points)
    z_up = [0, 2, 1]  # the normal is z in brdf.comp
    material = material_records(1.0, 0.0, 0.0, 1.0)
    with ShaderRunner(device, Path(__file__).parents[1] / "brdf/glsl") as shaders:
        brdf = run_brdf(shaders, "evaluate", len(wi), material, -directions[:, z_up], wi[:, z_up])[:, 1]
    logarithms = np.log2(1 + lit[there] * scene.camera.exposure / (share * brdf))
    error = np.abs(logarithms - np.log2(1 + chosen.exposed)) / step_and_rounding(logarithms)
    yield Measurement(CONTRIBUTION, float(error.max()), 1.0, "of half a step", f"{there.sum()} pixels")


def measure_places(device):
    """Counts the tiles of groups, and the places in these that the single candidates of their pixels have."""
    tiles, places = [], []
    with make_renderer(device, lamps_above(EXPOSED[8:]), (32, 32), **ALONE, di_candidates=1) as renderer:
        each, count = renderer.settings.light_tile_samples, renderer.settings.light_tile_count
        for _ in range(16):
            frame = renderer.render()
            index_of = {sample.tobytes(): index for index, sample in enumerate(frame["light_tile_samples"])}
            chosen = frame["di_reservoirs"]["light_sample"].reshape(4, 8, 4, 8).swapaxes(1, 2).reshape(16, 64)
            for group in chosen:
                found = np.array([index_of[s.tobytes()] for s in group if s["light_index"] != NO_INDEX], int)
                tiles.extend(found[:1] // each)
                places.extend(found % each)
    for name, numbers, among, bins in (("tiles", tiles, count, 8), ("places", places, each, 32)):
        observed = np.bincount(np.array(numbers) * bins // among, minlength=bins)
        z = standard_deviations(chi_squared_p(observed, np.full(bins, len(numbers) / bins)))
        yield Measurement(EVERYWHERE, z, _MAX_Z, "standard deviations", f"{name}: {len(numbers)}")


def measure_noise(device):
    """Choosing by packed records gives direct light with the same variance as choosing by the lights themselves."""
    scene = lamps_above(np.geomspace(3.0, 300.0, 12)[:, None] * COLOR, lux=1000.0)
    no_tiles = Bug(FILE, "sample_light_candidate", "return draw_light_candidate(rng);")
    variances = []
    for bugs in ((), (no_tiles,)):
        with seeded(*bugs), make_renderer(device, scene, (32, 32), **ALONE, di_candidates=32) as renderer:
            frames = [renderer.render()["di_diffuse"].sum(axis=-1, dtype=np.float64) for _ in range(16)]
            variances.append(float(np.var(frames, axis=0, ddof=1).mean()))
    yield Measurement(NOISE, variances[0] / variances[1] - 1, 0.2, "more variance")


# ---- samples against numpy --------------------------------------------------------------------------


def random_numbers(seeds):
    """The first two random numbers in [0, 1) of each seed."""
    return (pcg_hash(seeds) >> 8) * 2.0**-24, (pcg_hash(pcg_step(seeds)) >> 8) * 2.0**-24


# The second sizes are no multiples of the workgroup's.
@pytest.mark.parametrize(("tiles", "samples"), [(16, 512), (3, 47)])
def test_samples_are_packed_as_they_resolve(device, tiles, samples):
    """Resolves samples in float64: of a lamp, a distorted one with two sides, a mirrored one, and a wide sun."""
    scene = lamps_above(EXPOSED[8:9], angle=0.2)
    soup = sv.Mesh(positions=np.random.default_rng(7).normal(size=(21, 3)))
    two_sided = sv.Instance(soup, lamp(3e3, double_sided=True), place((0.3, 2.0, 0.7), (4, 1, 2), 0.7))
    scene.add(two_sided)
    scene.add(shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), lamp(1.0), place((-1, 1, 1), (-3, 2, 1)))
    settings = {"light_tile_count": tiles, "light_tile_samples": samples}
    with direct_renderer(device, scene, (8, 8), **settings) as renderer:
        named, packed, probabilities = take_tiles(renderer)
    assert named.shape == (1, tiles, samples)
    named, packed = named.ravel(), packed.ravel()
    emissive = [instance for instance in scene if instance.material.emits]
    sun, directional = scene.lights[0], named["light_index"] == len(emissive)
    solid_angle = 2 * np.pi * (1 - np.cos(sun.angular_diameter / 2))
    position, normal = packed["world_position"].astype(np.float64), -packed["world_position"].astype(np.float64)
    inverse_area_pdf = np.full(len(named), solid_angle / probabilities[-1])
    u, v = (numbers[:, None] for numbers in random_numbers(named["seed"]))
    for light, instance in enumerate(emissive):
        mine = named["light_index"] == light
        corners, shares = triangles_of(instance.mesh)
        part, m = named["part"][mine], instance.transform.astype(np.float64)
        a, b, c = transform_points(m, corners[part]).transpose(1, 0, 2)
        root, across = np.sqrt(u[mine]), v[mine]
        position[mine] = (1 - root) * a + root * (1 - across) * b + root * across * c
        cross = np.cross(b - a, c - a) * np.sign(np.linalg.det(m[:3, :3]))
        length = np.linalg.norm(cross, axis=1)
        normal[mine] = cross / length[:, None]
        inverse_area_pdf[mine] = length / 2 / (probabilities[light] * shares[part])
    np.testing.assert_allclose(packed["world_position"], position, atol=2e-5)
    np.testing.assert_allclose(packed["inverse_area_pdf"], inverse_area_pdf, rtol=1e-5)
    assert np.linalg.norm(decode_octahedral(packed["world_normal"]) - normal, axis=1).max() < 1e-4
    np.testing.assert_array_equal(packed["kind"], directional)  # 0 and 1 are rows of LIGHT_KINDS
    np.testing.assert_array_equal(packed["data"], named["light_index"] == emissive.index(two_sided))

    toward = position[directional]
    assert np.abs(np.linalg.norm(toward, axis=1) - 1).max() < 1e-6
    height = (1 - toward @ -sun.direction) * 2 * np.pi / solid_angle  # uniform over a disk on the sphere
    assert height.max() < 1 + 1e-3
    assert stats.kstest(height, "uniform").pvalue > 1e-3


def test_no_lights(device):
    scene = floor_scene(matte(0.5))
    with direct_renderer(device, scene, (16, 16)) as renderer:
        for _ in range(3):
            frame = renderer.render()
            assert (frame["di_reservoirs"]["light_sample"]["light_index"] == NO_INDEX).all()
            assert (frame["di_diffuse"] == 0).all()
            assert (frame["di_specular"] == 0).all()


# ---- each rule holds, and can fail ------------------------------------------------------------------


@pytest.mark.slow
def test_pixels_of_a_group_share_a_tile(device):
    """All 8x8 pixels choose from one tile, and groups from tiles of their own."""
    with make_renderer(device, lamps_above(EXPOSED[8:]), (64, 64), **ALONE) as renderer:
        frame = renderer.render()
        tiles, chosen = frame["light_tile_samples"], frame["di_temporal_reservoirs"]["light_sample"].reshape(64, 64)
        each = renderer.settings.light_tile_samples
    tile_of = {sample.tobytes(): index // each for index, sample in enumerate(tiles)}
    found = [
        {tile_of[sample.tobytes()] for sample in group.ravel() if sample["light_index"] != NO_INDEX}
        for row in chosen.reshape(8, 8, 8, 8).swapaxes(1, 2)
        for group in row
    ]
    lit = [group for group in found if group]
    assert len(lit) > 32
    assert all(len(group) == 1 for group in lit)
    assert len(set.union(*lit)) > 8  # of 16


@pytest.mark.slow
@pytest.mark.parametrize("measure", [measure_tiles, measure_places, measure_contribution, measure_noise])
def test_rules_hold(device, measure):
    require(measure(device))


def packing(change):
    """A bug that changes what is packed."""
    return Bug(FILE, "pack_light_sample", f"PackedLightSample packed = correct(resolved); {change} return packed;")


def seeding(seed):
    """A bug in the random numbers of tiles, of which each has 1024 samples."""
    return Bug(FILE, "draw_light_candidate", f"rng = {seed}; return correct(rng);")


test_a_seeded_bug_is_noticed = bug_tests(
    {
        ENCODED: (measure_tiles, packing("packed.radiance = pack_radiance_log2_rgb9e5(resolved.radiance, 1.0);")),
        SUN: (measure_tiles, packing("packed.radiance = pack_rgb9e5(resolved.radiance * this_frame.exposure);")),
        BLACK: (
            measure_tiles,
            Bug(
                FILE,
                "pack_light_sample",
                "resolved.radiance += 0.02 * max_component(resolved.radiance); return correct(resolved);",
            ),
        ),
        CHOICE: (measure_tiles, seeding("pcg(gl_GlobalInvocationID.x % 1024u)")),  # all tiles are alike
        UNIQUE: (measure_tiles, seeding("pcg(gl_GlobalInvocationID.x + 1024u * this_frame.index)")),  # seeds are summed
        SCROLL: (measure_tiles, seeding("pcg(gl_GlobalInvocationID.x)")),  # all frames are alike
        EVERYWHERE: (
            measure_places,
            Bug(
                FILE,
                "sample_light_candidate",
                "uint halves = light_tiles.samples_each / 2u, index = tile * 2u * halves + rand_range_u(halves, rng); "
                "return LightCandidate(light_tile_samples.at[index], unpack_light_sample(light_tiles.at[index]));",
            ),
        ),
        "tiles: the first half of them": (measure_places, Bug(FILE, "choose_light_tile", "return correct(rng) / 2u;")),
        CONTRIBUTION: (
            measure_contribution,
            Bug("common/packing.glsl", "pack_radiance_log2_rgb9e5", "return correct(2.0 * radiance, exposure);"),
        ),
        NOISE: (
            measure_noise,
            Bug("common/packing.glsl", "unpack_radiance_log2_rgb9e5", "return unpack_rgb9e5(bits) / exposure;"),
        ),
        "groups: a tile for each pixel": (
            test_pixels_of_a_group_share_a_tile,
            Bug(FILE, "choose_light_tile", "rng += gl_GlobalInvocationID.x; return correct(rng);"),
        ),
        "packed as they resolve: double-sided lights": (
            lambda device: test_samples_are_packed_as_they_resolve(device, 16, 512),
            packing("packed.data = 0u;"),
        ),
    }
)
