"""Light tiles: the distribution and packing of their samples, and direct light that uses them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.conformance import brdf_runs
from solari_vk.conformance.light_checks import floor_scene
from solari_vk.conformance.oracles import closed_forms, encodings, packed_lights
from solari_vk.conformance.realtime import OFF, make_renderer
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.patches import Patch, patched_shaders
from solari_vk.measure.statistics import chi_squared_p, standard_deviations
from solari_vk.renderer import Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb
from solari_vk.scene.lights import EQUAL_SHARE
from solari_vk.scene.spatial import spatial_order

_0_17, _0_18 = ("Solari in Bevy 0.17", "Presampling Lights"), ("Solari in Bevy 0.18", "Energy Loss Bug")
ENCODED = Rule("packed radiance from 1e-4 to 1e9 times white is exact within half a step of log2 rgb9e5", *_0_18)
SUN = Rule("a sun of 100,000 lux isn't clipped at EV100 9.7", *_0_18)
BLACK = Rule("a color channel of 0 stays 0", *_0_18)
DENSITY = Rule("1 / pdf of a sample is area, or solid angle for a sun, over the probability of its triangle", *_0_17)
KIND = Rule("a packed sample has its light's kind", SUITE, "Light tiles")
CHOICE = Rule("lights are chosen by power, one half equally often, and their triangles by area", SUITE, "Light tiles")
UNIQUE = Rule("the tiles of four frames hold no sample twice", *_0_17)
SCROLL = Rule("samples are uncorrelated within tiles, between tiles and between frames", *_0_17)
CONTRIBUTION = Rule("a packed sample lights a floor as the light itself does", *_0_17)
NOISE = Rule("choosing by tiles is no noisier than resolving each candidate", SUITE, "Light tiles")
Floats = NDArray[np.floating[Any]]
Samples = NDArray[Any]
_EACH = sv.Settings().light_tile_samples
_MAX_Z = NormalDist().inv_cdf(0.9999)
COLOR = np.array((1.0, 0.3, 0.0))
SATURATED = np.array((1.0, 0.5, 5e-4))
# Radiance of the lamps (16, 3) in units of white.
EXPOSED = np.geomspace(1e-4, 1e9, 16)[:, None] * np.where(np.arange(16)[:, None] % 2, SATURATED, COLOR)
HALF_SIDE = 0.1
BALL = 10.0
NO_TILES: tuple[Patch, ...] = (
    ("passes/light_tiles/light_tiles.glsl", "    uint index = tile *",
     "    return draw_light_candidate(rng);\n    uint index = tile *"),
)  # fmt: skip
"""Each candidate is drawn and resolved in the pass that uses it."""
EV100, LUX, SUN_ANGLE = 9.7, 100_000.0, 0.0093
ALONE: dict[str, Any] = {**OFF, "di": True, "di_temporal": False, "di_spatial": False}


def lamps_above(exposed: Floats, lux: float = LUX) -> sv.Scene:
    """A white floor under a grid of lamps of radiance `exposed` (N, 3), an emissive ball and the sun, in this order."""
    scene = floor_scene(matte(1.0))
    scene.camera.ev100 = EV100
    scene.add(sv.DirectionalLight(direction=rgb((0.3, -1, 0.2)), illuminance=lux, angular_diameter=SUN_ANGLE))
    for index, color in enumerate(exposed / scene.camera.exposure):
        at = (0.8 * (index % 4) - 1.2, 4.0, 0.8 * (index // 4) - 1.2)
        scene.add(sv.Instance(mesh=shapes.quad(at, (HALF_SIDE, 0, 0), (0, 0, HALF_SIDE)), material=lamp(color)))
    ball = lamp(BALL / scene.camera.exposure)
    scene.add(sv.Instance(mesh=shapes.sphere(0.2, 8), material=ball, transform=place(1.0, (0, 5, 0))))
    return scene


def _take_tiles(renderer: Renderer, frames: int) -> tuple[Samples, Samples]:
    """The light samples and their packed records, (frames, tiles, samples per tile) each."""
    taken = []
    for _ in range(frames):
        frame = renderer.render(renderer.binder.scene.camera)
        taken.append([frame["light_tile_samples"], frame["light_tiles"]])
    named, packed = (np.stack(of).reshape(frames, -1, _EACH) for of in zip(*taken, strict=True))
    return named, packed


def measure_tiles(device: Device) -> Iterator[Measurement]:
    """Measures the samples of four frames."""
    scene = lamps_above(EXPOSED)
    with make_renderer(device, scene, (8, 8), **OFF) as renderer:
        named, packed = _take_tiles(renderer, 4)
        powers = renderer.binder.lights.powers
    probabilities = (1 - EQUAL_SHARE) * powers / powers.sum() + EQUAL_SHARE / len(powers)
    yield from _measure_packing(named.ravel(), packed.ravel(), probabilities, scene.camera.exposure)
    yield from _measure_choice(named, probabilities)


def _measure_packing(named: Samples, packed: Samples, probabilities: Floats, exposure: float) -> Iterator[Measurement]:
    """Compares packed records with the lights of the scene."""
    light, count = named["light_index"], len(EXPOSED) + 2
    sun = closed_forms.sun_radiance(LUX, SUN_ANGLE) * exposure
    exposed = np.concatenate([EXPOSED, [(BALL,) * 3, (sun,) * 3]])[light]
    stored, expected = encodings.decode_rgb9e5(packed["radiance"]), np.log2(1 + exposed)
    error = (np.abs(stored - expected) / packed_lights.step_and_rounding(expected)).max()
    yield Measurement(ENCODED, float(error), 1.0, "of half a step")
    samples = packed_lights.decode(packed)
    error = np.abs(samples.exposed[light == count - 1] / sun - 1).max()
    half_step = float(packed_lights.half_step(np.log2([[1 + sun]])).item())
    yield Measurement(SUN, float(error), 2**half_step - 1, "relative error", f"{sun:.3g} times white")
    yield Measurement(BLACK, float((samples.exposed[exposed == 0] != 0).sum()), 0.0, "lit")
    solid_angle = 2 * math.pi * (1 - math.cos(SUN_ANGLE / 2))
    densities = {"a lamp": (light < len(EXPOSED), (2 * HALF_SIDE) ** 2), "the sun": (light == count - 1, solid_angle)}
    for name, (mine, area) in densities.items():
        products = packed["inverse_pdf"][mine].astype(np.float64) * probabilities[light[mine]]
        error = np.abs(products / area - 1).max()
        yield Measurement(DENSITY, float(error), 1e-5, "relative error", name)
    yield Measurement(KIND, float((samples.directional != (light == count - 1)).sum()), 0.0, "of another kind")


def _measure_choice(named: Samples, probabilities: Floats) -> Iterator[Measurement]:
    """Tests whether lights, triangles and random numbers are chosen independently and with the right probabilities."""
    ball = shapes.sphere(0.2, 8)
    corners = ball.positions[ball.triangles].astype(np.float64)
    a, b, c = corners[spatial_order(corners.mean(axis=1))].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    parts = [np.full(2, 0.5)] * len(EXPOSED) + [areas / areas.sum(), np.ones(1)]
    first = np.cumsum([0, *(len(of) for of in parts)])
    observed = np.bincount((first[named["light_index"]] + named["part"]).ravel(), minlength=first[-1])
    expected = named.size * np.concatenate([p * of for p, of in zip(probabilities, parts, strict=True)])
    z = standard_deviations(chi_squared_p(observed, expected))
    yield Measurement(CHOICE, z, _MAX_Z, "standard deviations")
    yield Measurement(UNIQUE, float(named.size - len(np.unique(named))), 0.0, f"of {named.size:,} again")
    seeds = named["seed"] / 2.0**32 - 0.5
    pairs = {
        "places": (seeds[..., :-1], seeds[..., 1:]), "tiles": (seeds[:, :-1], seeds[:, 1:]),
        "frames": (seeds[:-1], seeds[1:]), "scrolled": (seeds[:-1, :, 1:], seeds[1:, :, :-1]),
    }  # fmt: skip
    for name, (a, b) in pairs.items():
        z = abs(float((a * b).sum())) / math.sqrt(float((a**2).sum() * (b**2).sum()) / a.size)
        yield Measurement(SCROLL, z, _MAX_Z, "standard deviations", name)


def measure_contribution(device: Device, shaders: ShaderRunner) -> Iterator[Measurement]:
    """Compares ReSTIR DI with one candidate, which shades with the light itself, with the packed record's light."""
    scene, size = lamps_above(EXPOSED), (32, 32)
    with make_renderer(device, scene, size, **ALONE, di_candidates=1) as renderer:
        named, packed = (taken.ravel() for taken in _take_tiles(renderer, 1))
        reservoirs, lit = renderer["di_reservoirs"].ravel(), renderer["di_diffuse"].reshape(-1, 3).astype(np.float64)
    there = lit.max(axis=-1) > 0
    place_of = {sample.tobytes(): index for index, sample in enumerate(named)}
    chosen = packed_lights.decode(packed[[place_of[r.tobytes()] for r in reservoirs["light_sample"][there]]])
    origins, directions = (rays.reshape(-1, 3)[there] for rays in closed_forms.camera_rays(scene.camera, *size))
    points = origins - directions * (origins[:, 1:2] / directions[:, 1:2])
    wi, share = packed_lights.receive(chosen, points)
    z_up = [0, 2, 1]  # the normal is z in brdf.comp
    material = brdf_runs.materials(1.0, 0.0, 0.0, 1.0)
    brdf = brdf_runs.run(shaders, "evaluate", len(wi), material, -directions[:, z_up], wi[:, z_up])[:, 1]
    logarithms = np.log2(1 + lit[there] * scene.camera.exposure / (share * brdf))
    error = np.abs(logarithms - np.log2(1 + chosen.exposed)) / packed_lights.step_and_rounding(logarithms)
    yield Measurement(CONTRIBUTION, float(error.max()), 1.0, "of half a step", f"{there.sum()} pixels")


def measure_noise(device: Device) -> Iterator[Measurement]:
    """Choosing by packed records gives direct light with the same variance as choosing by the lights themselves."""
    scene = lamps_above(np.geomspace(3.0, 300.0, 12)[:, None] * COLOR, lux=1000.0)
    variances = []
    for patches in ((), NO_TILES):
        with patched_shaders(*patches), make_renderer(device, scene, (32, 32), **ALONE, di_candidates=32) as renderer:
            frames = [renderer.render(scene.camera)["di_diffuse"].sum(axis=-1, dtype=np.float64) for _ in range(16)]
            variances.append(float(np.var(frames, axis=0, ddof=1).mean()))
    yield Measurement(NOISE, variances[0] / variances[1] - 1, 0.2, "more variance")
