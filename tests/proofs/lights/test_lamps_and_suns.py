"""Lights: closed forms for a lamp and a sun over a floor, and changes that must not change the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from support.lamp_over_floor import (
    ALBEDO,
    BAR,
    BRIGHT,
    LAMP_CORNERS,
    PATCHES,
    floor_scene,
    lamp_above,
    lamp_on_lambert,
    on_lamp,
    patched_lamp,
)
from support.measured import hold
from support.oracles import closed_forms
from support.pictures import Picture, compare_picture, take_picture
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene.builtin import rgb

_CLOSED, _INVARIANT = "closed form", ("invariance", "the same light, described differently")


def measure_lamp(device: Device, strategy: str) -> Iterator[Measurement]:
    """An emissive polygon over a Lambert floor."""
    scene = floor_scene(sv.Material(base_color=rgb(ALBEDO)), lamp_above())
    samples, bar = (8192, 2 * BAR) if strategy == "brdf" else (1024, BAR)
    made = take_picture(device, scene, (32, 32), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    source = (_CLOSED, "irradiance of a polygon (Lambert 1760)")
    yield from compare_picture(f"a lamp over a floor, {strategy}", source, made, lamp_on_lambert(scene, 32), bar)


def measure_textured_lamp(device: Device, strategy: str) -> Iterator[Measurement]:
    """A lamp of many triangles of which few are bright."""
    scene = floor_scene(sv.Material(base_color=rgb(ALBEDO)), patched_lamp())
    samples, bar = (16384, 4 * BAR) if strategy == "brdf" else (1024, BAR)
    made = take_picture(device, scene, (32, 32), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    (left, right), (near, far) = ((part.start / PATCHES, part.stop / PATCHES) for part in BRIGHT)
    corners = on_lamp(np.array([left, right, right, left]), np.array([near, near, far, far]))
    source = (_CLOSED, "irradiance of a polygon (Lambert 1760)")
    expected = lamp_on_lambert(scene, 32, corners)
    yield from compare_picture(f"a lamp with a bright spot over a floor, {strategy}", source, made, expected, bar)


def measure_sun(device: Device, diameter: float, strategy: str) -> Iterator[Measurement]:
    """A sun's disk over a Lambert floor."""
    sun = sv.DirectionalLight(
        direction=rgb((1, -1.5, 0.3)), illuminance=1000, color=rgb((1, 0.8, 0.6)), angular_diameter=diameter
    )
    scene = floor_scene(sv.Material(base_color=rgb(0.6)), sun)
    samples, bar = (16384, 2 * BAR) if strategy == "brdf" else (512, BAR)
    made = take_picture(device, scene, (16, 16), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    irradiance = closed_forms.sun_irradiance(1000, diameter, 1.5 / math.sqrt(1 + 1.5**2 + 0.3**2))
    expected = irradiance * 0.6 / math.pi * np.array((1, 0.8, 0.6))
    source = (_CLOSED, "irradiance of a disk of constant radiance")
    yield from compare_picture(f"a sun {diameter:g} rad wide, {strategy}", source, made, expected, bar)


def measure_invariance(device: Device) -> Iterator[Measurement]:
    """Split and reordered lamps give the same picture; a brighter lamp gives a picture brighter by its factor."""
    floor = sv.Material(base_color=rgb(ALBEDO))

    def picture(*lamps: sv.Instance, seed: int = 0) -> Picture:
        scene = floor_scene(floor, *lamps)
        return take_picture(device, scene, (32, 32), 512, max_bounces=1, lambert=True, seed=seed)

    a, b, c, d = LAMP_CORNERS
    near, far = (a + b) / 2, (c + d) / 2
    parts = [lamp_above(np.array(corners)) for corners in ([a, near, far, d], [near, b, c, far])]
    whole = picture(lamp_above())
    for name, other in (
        ("a lamp in two parts", picture(*parts, seed=1)),
        ("the same parts in another order", picture(*parts[::-1], seed=2)),
    ):
        yield from compare_picture(name, _INVARIANT, other, whole.mean, 3 * BAR, whole.variance)
    bright = picture(lamp_above(brightness=1024.0))
    error = np.abs(bright.mean / (1024 * whole.mean) - 1).max()
    rule = Rule("a lamp 1024 times as bright gives 1024 times the radiance", *_INVARIANT)
    yield Measurement(rule, float(error), 1e-5, "relative error")


# ---- each rule holds, and can fail --------------------------------------------------------------------

# Random directions almost never meet the small sun.
SUNS = [(0.0093, "mis"), (0.0093, "nee"), (0.8, "mis"), (0.8, "nee"), (0.8, "brdf")]
SLOW = pytest.mark.slow


@pytest.mark.parametrize("strategy", ["mis", pytest.param("nee", marks=SLOW), pytest.param("brdf", marks=SLOW)])
def test_lamps_over_a_floor(device, strategy):
    hold(measure_lamp(device, strategy))
    hold(measure_textured_lamp(device, strategy))


@pytest.mark.parametrize("case", SUNS[:1] + [pytest.param(case, marks=SLOW) for case in SUNS[1:]])
def test_suns_over_a_floor(device, case):
    hold(measure_sun(device, *case))


def test_invariance(device):
    hold(measure_invariance(device))


SAMPLING = "scene/sampling.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    "a lamp": (lambda device: measure_lamp(device, "nee"), Bug(
        "scene/lights/choice.glsl", "part_probability", "return 1.02 * correct(light, part);")),
    "a lamp, by both strategies": (lambda device: measure_lamp(device, "mis"), Bug(
        "scene/lights/emissive_mesh.glsl", "emissive_hit_pdf", "return 4.0 * correct(hit, ray_direction, ray_t);")),
    "a textured lamp": (lambda device: measure_textured_lamp(device, "mis"), Bug(
        "scene/lights/choice.glsl", "choose_part", "return rand_range_u(light.part_count, rng);")),
    "a sun": (lambda device: measure_sun(device, 0.8, "mis"), Bug(
        SAMPLING, "met_radiance", "return correct(met, 0.5, bounce_pdf);")),
    "invariance": (measure_invariance, Bug(
        SAMPLING, "resolve_light_sample(LightSample light_sample, float",
        "ResolvedLightSample found = correct(light_sample, light_probability); found.inverse_pdf += 1.0; "
        "return found;")),
}, quick=("a lamp",))  # fmt: skip
