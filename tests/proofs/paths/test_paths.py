"""One path a pixel against closed forms of lamps and suns, and against the path tracer on every built-in scene."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.measured import hold

import solari_vk as sv
from solari_vk.conformance import paths_checks
from solari_vk.conformance.light_checks import LAMP_CORNERS, floor_scene, lamp_above, lamp_on_lambert
from solari_vk.conformance.oracles import closed_forms
from solari_vk.conformance.paths_checks import PASSES, PLAIN, SIZE, Profile, read_radiance
from solari_vk.conformance.realtime import Effort, make_renderer, measure_mean, measure_picture_tiles, run_pictures
from solari_vk.conformance.rules import Rule
from solari_vk.scene.builtin import SCENES, rgb

CENTER = LAMP_CORNERS.mean(axis=0)
# Corners of lamps over a floor: a lamp of 1 m, one of 1 cm, and one that nearly touches the floor.
LAMPS = {
    "wide": LAMP_CORNERS, "tiny": CENTER + 0.01 * (LAMP_CORNERS - CENTER),
    "near": np.array([(-1.5, 0.2, -1.5), (1.5, 0.2, -1.5), (1.5, 0.2, 1.5), (-1.5, 0.2, 1.5)]),
}  # fmt: skip
CANDIDATES = {"one": {}, "several": {"paths_candidates": 8}}
LIGHT = Rule("the light of a Lambert floor is its closed form", "closed form", "irradiance")
TILES = Rule("each of 4 x 4 tiles of a Lambert floor is its closed form", "closed form", "irradiance")


def measure_floor(device, scene, expected, **settings):
    """Require that the picture of a Lambert floor is `expected`."""
    effort = Effort(16, 0, 32)
    chosen = {**PLAIN, "jitter": True, "lambert": True, "paths_bounces": 1, **settings}
    with make_renderer(device, scene, SIZE, passes=PASSES, **chosen) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda frame: read_radiance(frame) * (expected > 0))
    tiles = measure_picture_tiles(TILES, found, expected, 0.02, effort)
    hold([measure_mean(LIGHT, found, expected, 0.005, effort), tiles])


@pytest.mark.parametrize("candidates", CANDIDATES)
@pytest.mark.parametrize("lamp", LAMPS)
def test_lamp_over_a_floor(device, lamp, candidates):
    scene = floor_scene(sv.Material(base_color=rgb((0.8, 0.5, 0.2))), lamp_above(LAMPS[lamp]))
    expected = lamp_on_lambert(scene, SIZE[0], LAMPS[lamp])
    measure_floor(device, scene, expected, **CANDIDATES[candidates])


@pytest.mark.parametrize("diameter", [0.0093, 0.8])
def test_sun_over_a_floor(device, diameter):
    sun = sv.DirectionalLight(direction=rgb((1, -1.5, 0.3)), illuminance=10.0, angular_diameter=diameter)
    scene = floor_scene(sv.Material(base_color=rgb(0.6)), sun)
    irradiance = closed_forms.sun_irradiance(10.0, diameter, 1.5 / math.sqrt(1 + 1.5**2 + 0.3**2))
    measure_floor(device, scene, np.full((*SIZE, 3), irradiance * 0.6 / math.pi))


# The frames of each of 16 runs, and the bar of the mean: about twice the interval. Small lights among many boxes are
# found by chance alone with one sample a vertex, hence the wide bar.
EFFORTS = {"many_lights": (64, 0.06), "shiny_floor": (128, 0.02), "mirror_hall": (128, 0.015)}
CHANGED = {"many_lights": {"sphere_count": 49, "box_count": 300}}


@pytest.mark.parametrize("name", [n if n == "cornell_box" else pytest.param(n, marks=pytest.mark.slow) for n in SCENES])
def test_without_the_cache_paths_are_the_path_tracers(device, name):
    """P-REPL: with one light sample a vertex, and with several."""
    frames, bar = EFFORTS.get(name, (64, 0.01))
    profile = Profile(Effort(16, 0, frames, 8192), Effort(), (bar, 0.0))
    scene = sv.builtin(name, **CHANGED.get(name, {}))
    hold(paths_checks.measure_means(device, profile, scene, kinds=("one", "several")))


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.01, 0.1])
def test_lamp_under_a_ceiling(device, gap):
    profile = Profile(Effort(16, 0, 64, 8192), Effort(16, 24, 64), (0.01, 0.02))
    hold(paths_checks.measure_means(device, profile, sv.builtin("lamp_gap", gap=gap)))
