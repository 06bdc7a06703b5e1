"""Point lights, spotlights and sphere lights: closed forms for how they light a floor, and what rays see of them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.lamp_over_floor import BAR, floor_scene
from support.measured import hold
from support.oracles.closed_forms import over_pixels
from support.pictures import compare_picture, take_picture
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene.builtin import rgb
from solari_vk.scene.lights.punctual import PunctualLight

Floats = NDArray[np.floating[Any]]
_SOURCE = ("KHR_lights_punctual", "Punctual lights")
SEEN = Rule("a ray that meets a sphere light sees its intensity over the area of its outline", *_SOURCE)
CIRCLE = Rule("a camera sees a sphere light as large as it is", *_SOURCE)
_AT, _HIGH, _TILTED = rgb((0.3, 1.2, -0.2)), rgb((0.5, 3.6, -0.3)), rgb((0.3, -1, 0.2))
_ALBEDO, _COLOR, _SIZE = 0.6, rgb((1, 0.7, 0.3)), 32
# Spheres hang above the camera, which would see them otherwise.
LAMPS: dict[str, PunctualLight] = {
    "a point light": sv.PointLight(_AT, intensity=3, color=_COLOR),
    "a point light with a range": sv.PointLight(_AT, intensity=3, range=2),
    "a spotlight": sv.SpotLight(_AT, _TILTED, intensity=5, inner_cone_angle=0.3, outer_cone_angle=0.7),
    "a spotlight with a hard edge": sv.SpotLight(_AT, _TILTED, inner_cone_angle=0.599, outer_cone_angle=0.6),
    "a sphere light": sv.PointLight(_HIGH, intensity=50, color=_COLOR, radius=0.5),
    "a spotlight with a radius": sv.SpotLight(_HIGH, _TILTED, intensity=50, radius=0.4, outer_cone_angle=0.9),
}

# A lamp and a light strategy each. Random directions meet only lamps with a radius.
CASES = [(name, "mis") for name in LAMPS] + [
    (name, strategy) for name, lamp in LAMPS.items() if lamp.radius for strategy in ("nee", "brdf")
]


def irradiance(light: PunctualLight, points: Floats) -> Floats:
    """Irradiance (N,) of points (N, 3) of a floor, from the formulas of KHR_lights_punctual.

    That of a sphere that is wholly above a surface is that of a point at its center: its solid angle times the mean
    cosine in it is pi (radius / distance)^2 times the cosine to its center.
    """
    away = points - light.position
    distance = np.linalg.norm(away, axis=1)
    away /= distance[:, None]
    share = np.ones(len(points))
    if isinstance(light, sv.SpotLight):
        inner, outer = math.cos(light.inner_cone_angle), math.cos(light.outer_cone_angle)
        share = np.clip((away @ light.direction - outer) / max(inner - outer, 0.001), 0, 1) ** 2
    if light.range is not None:
        share = share * np.clip(1 - (distance / light.range) ** 4, 0, 1)
    found: Floats = light.intensity * share * -away[:, 1] / distance**2
    return found


def lit_floor(scene: sv.Scene, size: int, nodes: int = 8) -> Floats:
    """The picture (size, size, 3) of a Lambert floor under the scene's lights, by their closed forms."""
    total: Floats = np.zeros((size, size, 3))
    for light in scene.lights:
        assert isinstance(light, PunctualLight)
        received = functools.partial(irradiance, light)
        total = total + over_pixels(scene.camera, size, received, nodes) * light.color
    return total * (_ALBEDO / math.pi)


def measure_floor(device: Device, name: str, strategy: str) -> Iterator[Measurement]:
    """One of LAMPS over a Lambert floor."""
    scene = floor_scene(sv.Material(base_color=rgb(_ALBEDO)), LAMPS[name])
    samples, bar = (16384, 3 * BAR) if strategy == "brdf" else (512, BAR)
    made = take_picture(device, scene, (_SIZE, _SIZE), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    yield from compare_picture(f"{name} over a floor, {strategy}", _SOURCE, made, lit_floor(scene, _SIZE), bar)


def measure_several(device: Device) -> Iterator[Measurement]:
    """All lamps at once: the light of each is added."""
    scene = floor_scene(sv.Material(base_color=rgb(_ALBEDO)), *LAMPS.values())
    made = take_picture(device, scene, (_SIZE, _SIZE), 2048, max_bounces=1, lambert=True)
    yield from compare_picture("six lamps over a floor", _SOURCE, made, lit_floor(scene, _SIZE), 2 * BAR)


def measure_seen(device: Device) -> Iterator[Measurement]:
    """A sphere light before nothing, seen by a camera: its radiance, and the solid angle in which there is light."""
    radius, distance, intensity = 0.5, 2.0, 3.0
    lamp = sv.PointLight(rgb((0, 0, -distance)), intensity=intensity, radius=radius, color=rgb(_COLOR))
    half = math.asin(radius / distance)
    camera = sv.Camera(vertical_fov=3 * half)
    made = take_picture(device, sv.Scene(lamp, camera), (64, 64), 64, max_bounces=0).mean
    radiance = intensity / (math.pi * radius**2) * np.array(_COLOR)
    error = np.abs(made[32, 32] / radiance - 1).max()
    yield Measurement(SEEN, float(error), 1e-5, "relative error")
    # Seen straight on, the outline is a circle of this share of the picture.
    share = math.pi / 4 * (math.tan(half) / math.tan(1.5 * half)) ** 2
    error = abs(float(made[..., 0].mean()) / (radiance[0] * share) - 1)
    yield Measurement(CIRCLE, error, 0.005, "relative error")


# ---- each rule holds, and can fail --------------------------------------------------------------------

@pytest.mark.parametrize("case", [case if case[1] == "mis" else pytest.param(case, marks=pytest.mark.slow)
                                  for case in CASES], ids="-".join)  # fmt: skip
def test_lamps_over_a_floor(device, case):
    hold(measure_floor(device, *case))


@pytest.mark.slow
def test_the_light_of_lamps_adds_up(device):
    hold(measure_several(device))


def test_sphere_lights_are_seen(device):
    hold(measure_seen(device))


def over_floor(name, strategy="mis"):
    return lambda device: measure_floor(device, name, strategy)


SPHERE, FALLOFF = "scene/lights/sphere.glsl", ("scene/lights/punctual.glsl", "punctual_falloff")
test_a_seeded_bug_is_noticed = bug_tests({
    "points have no density": (over_floor("a point light"), Bug(
        "scene/sampling.glsl", "is_met_by_rays", "return true;")),
    "a range": (over_floor("a point light with a range"), Bug(
        *FALLOFF, "light.inverse_range = 0.0; return correct(light, direction, distance);")),
    "a cone": (over_floor("a spotlight"), Bug(*FALLOFF, "return sqrt(correct(light, direction, distance));")),
    "the density of a cone": (over_floor("a sphere light", "nee"), Bug(
        SPHERE, "sphere_cone", "SphereCone cone = correct(light, receiver); cone.one_minus_cos *= 0.9; return cone;")),
    "hits of spheres": (over_floor("a sphere light"), Bug(
        SPHERE, "cross_sphere", "MetLight met = correct(index, origin, direction, t_max); met.inverse_pdf *= 20.0; "
        "return met;")),
    "a spotlight's rays": (over_floor("a spotlight with a radius", "brdf"), Bug(
        SPHERE, "cross_sphere", "MetLight met = correct(index, origin, direction, t_max); "
        "met.radiance = sphere_lights.at[index].strength; return met;")),
    "several lamps": (measure_several, Bug(
        "scene/lights/point.glsl", "emission_cosine_point", "return 0.9;")),
    SEEN: (measure_seen, Bug(SPHERE, "cross_sphere", "MetLight met = correct(index, origin, direction, t_max); "
                             "met.radiance *= 0.25; return met;")),
    CIRCLE: (measure_seen, Bug(
        SPHERE, "sphere_cone", "light.radius *= 1.1; return correct(light, receiver);")),
}, quick=("a cone",))  # fmt: skip
