"""Dispersion: where a prism sends each color, by Snell's law; white glass in an even environment; realtime frames."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import (
    PATHS,
    PLAIN_PATHS,
    Effort,
    make_renderer,
    observe_runs,
    path_traced_runs,
    path_tracer_at_centers,
    read_radiance,
)
from support.seeded_bugs import Bug, bug_tests
from support.statistics import relative_interval

import solari_vk as sv
from solari_vk.scene import shapes

FILE = "scene/lobes/dispersion.glsl"
IOR = 1.5
DISPERSION = 1.0
WIDTH = 1024
CORNERS = [np.array((np.cos(angle), np.sin(angle))) for angle in np.radians((90, 210, 330))]  # of a prism, x and z
LEFT, RIGHT = (np.array((np.cos(angle), np.sin(angle))) for angle in np.radians((150, 30)))  # normals of its faces
TOWARDS = np.array((np.cos(np.radians(18.6)), np.sin(np.radians(18.6))))  # a way of least deviation begins so
LONGITUDES = 2 * np.pi * ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5)
EXIT = np.radians(-18.6)
MAPS = {  # along the longitude, around the direction in which light leaves
    "a ramp": np.clip((LONGITUDES - EXIT) / np.radians(8) + 0.5, 0, 1) * (np.abs(LONGITUDES) < 1),
    "an edge": np.where((np.radians(-19.4) > LONGITUDES) & (LONGITUDES > -1), 1.0, 0.0),
}
BANDS, BAND_WIDTH = (610, 540, 450), 70


def prism(light, **fields):
    """A prism that fills the picture, and light that it sends there."""
    low, high = ([(x, y, z) for x, z in CORNERS] for y in (-1.0, 1.0))
    sides = [[low[i], low[i - 2], high[i - 2], high[i]] for i in range(3)]
    sides = [
        side
        if np.dot(np.cross(np.subtract(side[1], side[0]), np.subtract(side[2], side[0])), side[0]) > 0
        else side[::-1]
        for side in sides
    ]
    glass = sv.Material(base_color=1, transmission=1, roughness=0, solid=True, ior=IOR, dispersion=DISPERSION)
    scene = sv.Scene(sv.Instance(shapes.polygons(*sides, low, high[::-1]), glass))
    glass.update(**fields)
    scene.environment = sv.Environment(np.repeat(light[None, :, None], 3, axis=2).astype(np.float32).repeat(4, axis=0))
    middle, towards = (np.array((x, 0, z)) for x, z in ((CORNERS[0] + CORNERS[1]) / 2, TOWARDS))
    scene.camera = sv.Camera.look_at(middle - 3 * towards, middle, orthographic_height=0.05)
    return scene


def refracted(direction, normal, eta):
    """Snell's law, and the share of light that passes. eta: of the index of refraction before over that behind."""
    cosine = -np.dot(direction, normal)
    below = np.sqrt(1 - eta**2 * (1 - cosine**2))
    s, p = (eta * cosine - below) / (eta * cosine + below), (cosine - eta * below) / (cosine + eta * below)
    return eta * direction + (eta * cosine - below) * normal, 1 - (s**2 + p**2) / 2


def expected(light, dispersion=DISPERSION):
    """What the prism shows, (3,), by the equation of KHR_materials_dispersion."""
    found = []
    for band in BANDS:
        waves = band + np.linspace(-1, 1, 401) * BAND_WIDTH
        seen = []
        for wave in waves:
            ior = max(IOR + (IOR - 1) * dispersion / 20 * (523655 / wave**2 - 1.5168), 1)
            inside, first = refracted(TOWARDS, LEFT, 1 / ior)
            outside, second = refracted(inside, -RIGHT, ior)
            seen.append(first * second * np.interp(np.arctan2(outside[1], outside[0]), LONGITUDES, light))
        found.append(np.average(seen, weights=BAND_WIDTH - np.abs(waves - band)))
    return np.array(found)


def check_prism(device, name, fields=None, dispersion=DISPERSION):
    light = MAPS[name]
    scene = prism(light, **(fields or {}))
    found = path_traced_runs(device, scene, (8, 8), 512, max_bounces=2).mean.mean(axis=(0, 1))
    print(name, found, expected(light, dispersion))
    np.testing.assert_allclose(found, expected(light, dispersion), atol=0.004)


@pytest.mark.parametrize("name", MAPS)
def test_a_prism_bends_each_color_by_snells_law(device, name):
    """The ramp tells the mean angle of each color, the edge how wide its band is."""
    spread = np.ptp(expected(MAPS[name]))
    assert spread > 0.2, "the colors go apart"
    check_prism(device, name)


@pytest.mark.parametrize(("fields", "dispersion"), [({"dispersion": 0}, 0), ({"dispersion": 0.3}, 0.3)])
def test_less_dispersion(device, fields, dispersion):
    check_prism(device, "a ramp", fields, dispersion)


def check_furnace(device, **fields):
    """White glass is invisible in an even environment, color by color, from outside and, if `within`, from inside.

    A box keeps some light for ever from an index of refraction of 1.22 on.
    """
    within = fields.pop("within", False)
    glass = {"base_color": 1.0, "transmission": 1.0, "solid": True, "dispersion": 2.0, "ior": 1.8, **fields}
    scene = sv.Scene(sv.Instance(shapes.box(), sv.Material(**glass, double_sided=True)))
    scene.environment = sv.Environment(np.ones((4, 8, 3), np.float32))
    eye = (0.1, 0.2, 0.1) if within else (1.2, 1.0, 1.5)
    scene.camera = sv.Camera.look_at(eye, (0, 0, 0), vertical_fov=0.6)
    found = path_traced_runs(device, scene, (8, 8), 1024, max_bounces=200).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(found, 1.0, rtol=0.015)


@pytest.mark.parametrize(
    "fields",
    [
        {"roughness": 0.0},
        {"roughness": 0.5},
        {"roughness": 0.0, "within": True, "ior": 1.15},
        {"roughness": 0.3, "transmission": 0.5, "diffuse_transmission": 1.0},
    ],
    ids=["smooth", "rough", "within", "half"],
)
def test_white_glass_is_invisible(device, fields):
    check_furnace(device, **fields)


EFFORT = Effort(16, 0, 64, 4096)


@pytest.mark.slow  # minutes
def test_frames_have_the_path_tracers_colors(device):
    """Realtime frames of the prism, color by color, without the denoiser, against the path tracer."""
    scene, size = prism(MAPS["a ramp"]), (8, 8)
    with make_renderer(device, scene, size, passes=PATHS, **PLAIN_PATHS) as renderer:
        found = observe_runs(renderer, scene.camera, EFFORT, read_radiance)
    with path_tracer_at_centers():
        right = path_traced_runs(device, scene, size, EFFORT.samples, max_bounces=64).mean
    assert np.ptp(right.mean(axis=(0, 1))) > 0.1
    for channel in range(3):
        error, half_width = relative_interval(found[..., channel], right[..., channel])
        print(f"{error:+.2%} +- {half_width:.2%}")
        assert abs(error) + half_width < 0.01


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "the equation": (
            lambda device: check_prism(device, "a ramp"),
            Bug(FILE, "dispersed_ior", "return correct(ior, 0.9 * dispersion, inverse_square);"),
        ),
        "bands": (lambda device: check_prism(device, "an edge"), Bug(FILE, "BAND_WIDTH", "50.0")),
        "light is gained": (
            lambda device: check_furnace(device, roughness=0.5),
            Bug(FILE, "wavelength_color", "return 1.03 * correct(wavelength);"),
        ),
        "frames": (
            test_frames_have_the_path_tracers_colors,
            Bug("passes/paths/reservoir.glsl", "wavelength_u", "return 0.7 * correct(pixel);"),
        ),
    },
    quick=("the equation",),
)
