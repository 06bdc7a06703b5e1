"""Each kind of light against closed forms of how it lights a floor and looks to a camera; and the same light, described
differently."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from oracles.encodings import decode_srgb
from oracles.light import (
    ALBEDO,
    LAMP_CORNERS,
    floor_scene,
    lamp_above,
    lamp_on_lambert,
    on_lamp,
    sun_irradiance,
    sun_radiance,
)
from oracles.rays import over_pixels
from support.frames import path_traced_runs
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import compare_picture

import solari_vk as sv
from solari_vk.scene.builtin import rgb

_CLOSED = ("closed form", "Lambert 1760, KHR_lights_punctual, and disks of constant radiance")
_INVARIANT = ("invariance", "the same light, described differently")
SEEN = Rule("a camera sees the radiance of a light: its intensity, or illuminance, over its outline", *_CLOSED)
CIRCLE = Rule("a camera sees a light as large as it is", *_CLOSED)
_AT = (0.3, 1.2, -0.2)
_HIGH = (0.5, 3.6, -0.3)
_TILTED = (0.3, -1, 0.2)
_ORANGE, _SUN = rgb((1, 0.7, 0.3)), rgb((1, -1.5, 0.3))


# Five standard errors more than the interval on lavapipe, because other devices give other noise.
BAR = 0.005


PATCHES, BRIGHT = 8, (slice(1, 5), slice(3, 5))  # along the lamp's sides


def patched_lamp():
    """The lamp in PATCHES x PATCHES patches; its texture is black but for those of BRIGHT, where it is white."""
    steps = np.linspace(0, 1, PATCHES + 1)
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    first = (np.arange(PATCHES)[:, None] * (PATCHES + 1) + np.arange(PATCHES)).ravel()
    quads = first[:, None] + np.array([0, 1, PATCHES + 2, PATCHES + 1])
    pixels = np.zeros((PATCHES, PATCHES, 3), np.uint8)
    pixels[BRIGHT[1], BRIGHT[0]] = 255
    lamp = lamp_above()
    lamp.mesh = sv.Mesh(on_lamp(u, v), quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), uvs=np.stack([u, v], axis=1))
    lamp.material.emissive_texture = sv.Texture(sv.TextureImage(pixels), magnification="nearest")
    return lamp


class Lit(NamedTuple):
    """Lights, and the bars of the mean with light samples, and with random directions alone, which must meet them."""

    lights: tuple[Any, ...]
    bar: float = BAR
    bar_of_rays: float | None = None
    samples: int = 512
    size: int = 32


# Spheres hang above the camera, which would see them otherwise.
PUNCTUAL = {
    "a point light": sv.PointLight(_AT, intensity=3, color=_ORANGE),
    "a point light with a range": sv.PointLight(_AT, intensity=3, range=2),
    "a spotlight": sv.SpotLight(_AT, _TILTED, intensity=5, inner_cone_angle=0.3, outer_cone_angle=0.7),
    "a spotlight with a hard edge": sv.SpotLight(_AT, _TILTED, inner_cone_angle=0.599, outer_cone_angle=0.6),
    "a sphere light": sv.PointLight(_HIGH, intensity=50, color=_ORANGE, radius=0.5),
    "a spotlight with a radius": sv.SpotLight(_HIGH, _TILTED, intensity=50, radius=0.4, outer_cone_angle=0.9),
}
FOUR_COLORS = lamp_above()
FOUR_COLORS.material.emissive_texture = sv.Texture(
    np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (200, 100, 50)]], np.uint8), magnification="nearest"
)
SUNS = [sv.DirectionalLight(_SUN, illuminance=1000, color=(1, 0.8, 0.6), angular_diameter=d) for d in (0.0093, 0.8)]
LIT = {
    "a lamp": Lit((lamp_above(),), BAR, 2 * BAR, samples=1024),
    "a lamp with a bright spot": Lit((patched_lamp(),), BAR, 4 * BAR, samples=1024),
    "a lamp of four colors": Lit((FOUR_COLORS,), BAR, 4 * BAR, samples=1024),
    "a small sun": Lit((SUNS[0],), size=16),
    "a wide sun": Lit((SUNS[1],), BAR, 2 * BAR, size=16),
    **{name: Lit((light,), BAR, 3 * BAR if light.radius else None) for name, light in PUNCTUAL.items()},
    "six lights": Lit(tuple(PUNCTUAL.values()), 2 * BAR, samples=2048),
}
ONLY_MIS = {"six lights", "a point light", "a point light with a range", "a spotlight", "a spotlight with a hard edge"}
SLOW = {
    ("a wide sun", "mis"),
    ("six lights", "mis"),
    *((name, "nee") for name in LIT if name not in ONLY_MIS),
    *((name, "brdf") for name, lit in LIT.items() if lit.bar_of_rays),
}
QUICK = {(name, "mis") for name in LIT} - SLOW


def irradiance(light, points):
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
    found = light.intensity * share * -away[:, 1] / distance**2
    return found


def lit_floor(scene, light, size):
    """The picture (size, size, 3) of a Lambert floor under a light, by its closed form."""
    if isinstance(light, sv.Instance):
        texture = light.material.emissive_texture
        texels = decode_srgb(texture.image.pixels[..., :3]) if texture else np.ones((1, 1, 3))
        total = np.zeros((size, size, 3))
        for v, u in np.argwhere(texels.max(axis=-1) > 0):
            across, along = np.array([(u, u + 1, u + 1, u), (v, v, v + 1, v + 1)]) / len(texels)
            total += lamp_on_lambert(scene, size, on_lamp(across, along)) * texels[v, u]
        return total
    if isinstance(light, sv.DirectionalLight):
        received = sun_irradiance(light.illuminance, light.angular_diameter, -light.direction[1])
    else:
        is_hard = getattr(light, "inner_cone_angle", 0.0) > 0.5
        received = over_pixels(scene.camera, size, functools.partial(irradiance, light), nodes=64 if is_hard else 32)
    return np.broadcast_to(received * light.color * ALBEDO / math.pi, (size, size, 3))


def measure_floor(device, name, strategy="mis"):
    """A Lambert floor under some of LIT."""
    lights, bar, bar_of_rays, samples, size = LIT[name]
    if strategy == "brdf":
        samples, bar = 8192 if name == "a lamp" else 16384, bar_of_rays
    scene = floor_scene(sv.Material(base_color=ALBEDO), *lights)
    made = path_traced_runs(device, scene, (size, size), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    expected = sum(lit_floor(scene, light, size) for light in lights)
    yield from compare_picture(f"{name} over a floor, {strategy}", _CLOSED, made, expected, bar)


def measure_seen(device):
    """A sphere light and a sun before nothing: the radiance, and the solid angle in which there is light."""
    radius = 0.5
    distance = 2.0
    intensity = 3.0
    sphere = sv.PointLight((0, 0, -distance), intensity=intensity, radius=radius, color=_ORANGE)
    sun = sv.DirectionalLight((0, 0, 1), illuminance=100, angular_diameter=0.5)
    for light, half, radiance in (
        (sphere, math.asin(radius / distance), intensity / (math.pi * radius**2)),
        (sun, 0.25, sun_radiance(100, 0.5)),
    ):
        scene = sv.Scene(light, sv.Camera(vertical_fov=3 * half))
        made = path_traced_runs(device, scene, (64, 64), 64, max_bounces=0).mean
        error = np.abs(made[32, 32] / (radiance * light.color) - 1).max()
        yield Measurement(SEEN, float(error), 1e-5, "relative error")
        # Seen straight on, the outline is a circle of this share of the picture.
        share = math.pi / 4 * (math.tan(half) / math.tan(1.5 * half)) ** 2
        yield Measurement(CIRCLE, abs(float(made[..., 0].mean()) / (radiance * share) - 1), 0.005, "relative error")


def measure_invariance(device):
    """Split and reordered lamps give the same picture; a brighter lamp gives a picture brighter by its factor."""

    def picture(*lamps, seed=0):
        scene = floor_scene(sv.Material(base_color=ALBEDO), *lamps)
        return path_traced_runs(device, scene, (32, 32), 512, max_bounces=1, lambert=True, seed=seed)

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


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow if case in SLOW else ()) for case in sorted(QUICK | SLOW)],
    ids="-".join,
)
def test_lights_over_a_floor(device, case):
    require(measure_floor(device, *case))


@pytest.mark.parametrize("measure", [measure_seen, measure_invariance])
def test_rules_hold(device, measure):
    require(measure(device))


def over_floor(name, strategy="mis"):
    return lambda device: measure_floor(device, name, strategy)


SAMPLING, CHOICE = "scene/sampling.glsl", "scene/lights/choice.glsl"
SPHERE, FALLOFF = "scene/lights/sphere.glsl", ("scene/lights/punctual.glsl", "punctual_falloff")


def meeting_spheres(change):
    """A bug in the light that a ray meets."""
    met = "LightHit met = correct(index, origin, direction, t_max)"
    return Bug(SPHERE, "intersect_sphere", f"{met}; {change}; return met;")


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a lamp": (
            over_floor("a lamp", "nee"),
            Bug(
                CHOICE,
                "part_of_leaf",
                "PartOfLeaf found = correct(light, part); found.probability *= 1.02; return found;",
            ),
        ),
        "a lamp, by both strategies": (
            over_floor("a lamp"),
            Bug(
                "scene/lights/emissive_mesh.glsl",
                "emissive_hit_pdf",
                "return 4.0 * correct(hit, ray_direction, ray_t);",
            ),
        ),
        "a textured lamp": (
            over_floor("a lamp with a bright spot"),
            Bug(CHOICE, "choose_part", "return leaf.first_part + rand_range_u(leaf.part_count, rng);"),
        ),
        "a sun": (
            over_floor("a wide sun"),
            Bug(SAMPLING, "mis_weighted_radiance", "return correct(light_hit, 0.5, mis_pdf);"),
        ),
        "points have no density": (over_floor("a point light"), Bug(SAMPLING, "can_be_hit_by_rays", "return true;")),
        "a range": (
            over_floor("a point light with a range"),
            Bug(*FALLOFF, "light.inverse_range = 0.0; return correct(light, direction, distance);"),
        ),
        "a cone": (over_floor("a spotlight"), Bug(*FALLOFF, "return sqrt(correct(light, direction, distance));")),
        "the density of a cone": (
            over_floor("a sphere light", "nee"),
            Bug(
                SPHERE,
                "sphere_cone",
                "SphereCone cone = correct(light, receiver); cone.one_minus_cos *= 0.9; return cone;",
            ),
        ),
        "hits of spheres": (over_floor("a sphere light"), meeting_spheres("met.inverse_solid_angle_pdf *= 20.0")),
        "a spotlight's rays": (
            over_floor("a spotlight with a radius", "brdf"),
            meeting_spheres("met.radiance = sphere_lights.at[index].strength"),
        ),
        "several lamps": (
            over_floor("six lights"),
            Bug("scene/lights/point.glsl", "emission_cosine_point", "return 0.9;"),
        ),
        "invariance": (
            measure_invariance,
            Bug(CHOICE, "choice_probability_by_power", "return part_of_leaf(light, part).probability;"),
        ),
        SEEN: (measure_seen, meeting_spheres("met.radiance *= 0.25")),
        CIRCLE: (measure_seen, Bug(SPHERE, "sphere_cone", "light.radius *= 1.1; return correct(light, receiver);")),
    },
    quick=("a lamp", "a cone"),
)
