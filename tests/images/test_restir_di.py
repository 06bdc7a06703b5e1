"""ReSTIR DI against the path tracer: options that don't change the mean, behaviors of Solari that do, and history."""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
import pytest
from support.measured import hold
from support.older_solari import CONSTANT_WEIGHTS, VISIBILITY_FED_FORWARD
from support.statistics import replicates

import solari_vk as sv
from solari_vk.conformance.direct_checks import ALONE, FULL, find_lit_share, measure_direct, observe_direct
from solari_vk.conformance.realtime import Effort, make_renderer, trace
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.statistics import relative_interval, sixteenths
from solari_vk.passes import pathtracer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, many_lights, matte
from solari_vk.scene.constants import NO_INDEX

SIDE = 48
CENTERS = {"gbuffer": "traced", "jitter": False}  # samples lie at pixel centers, as in trace_centers
# Less reuse than by default: frames are less correlated, so that fewer of them suffice, and a bias would stay as large.
LITTLE_REUSE = {"di_confidence_cap": 4.0, "di_spatial_radius": 12.0}


def trace_centers(device, scene, samples):
    """The path tracer's direct light, with all samples at pixel centers, so that edges add no noise."""
    with mock.patch.dict(pathtracer.PIXEL_FILTERS, box=0.0):
        one, none = (trace(device, scene, samples, (SIDE, SIDE), max_bounces=count) for count in (1, 0))
    return one - none


@pytest.fixture(scope="module")
def cornell(device):
    """The Cornell box, its direct light, and the share of the lamp that each pixel sees."""
    scene = cornell_box()
    return scene, trace_centers(device, scene, 1024), find_lit_share(device, scene, SIDE)


def renderer_of(device, scene, size=(SIDE, SIDE), **settings):
    return make_renderer(device, scene, size, **ALONE, **(CENTERS | settings))


def observe(device, scene, observed=16, **settings):
    """The mean of the last `observed` frames in each of 16 independent runs, (16, SIDE, SIDE, 3)."""
    return observe_direct(device, scene, SIDE, Effort(16, 24, observed), **(CENTERS | settings))


def assert_within(observations, truth, bar, what=""):
    error, half_width = relative_interval(observations, truth)
    assert abs(error) + half_width <= bar, f"{what}: {100 * error:+.2f} % +- {100 * half_width:.2f} %"


def test_no_sixteenth_of_a_cornell_box_differs(device, cornell):
    """No tile of 4 x 4 differs from the path tracer. The conformance suite proves the means in light, penumbra and
    shadow."""
    scene, truth, _ = cornell
    assert replicates(sixteenths(observe(device, scene, 48)), sixteenths(truth), 0.01) == (0, True)


@pytest.mark.slow  # takes two thousand frames
def test_full_profile(device):
    hold(measure_direct(device, FULL))


# Behaviors of Solari, and between which bounds their relative error lies in the whole Cornell box and in its penumbra.
BIASED = {
    "initial visibility": ({"di_initial_visibility": True}, (), (-0.10, -0.03), (-0.35, -0.12)),
    "order of 0.17": ({"di_initial_visibility": True}, VISIBILITY_FED_FORWARD, (-0.35, -0.05), (-0.80, -0.25)),
    "constant weights": ({}, CONSTANT_WEIGHTS, (-0.10, -0.005), (-0.15, 0.02)),
}


@pytest.mark.parametrize("name", BIASED)
def test_solaris_behaviors_are_biased(device, cornell, name):
    """Each behavior loses light, most of it in penumbras: testing the visibility of samples before they are merged, and
    merge weights that ignore the target functions."""
    settings, patches, everywhere, in_penumbra = BIASED[name]
    scene, truth, share = cornell
    with patched_shaders(*patches):
        observations = observe(device, scene, 8, **settings)
    penumbra = (share > 0) & (share < 1)
    for pixels, (low, high) in ((share >= 0, everywhere), (penumbra, in_penumbra)):
        error, half_width = relative_interval(observations[:, pixels], truth[pixels])
        assert low < error - half_width
        assert error + half_width < high


@pytest.mark.parametrize("settings", [
    {"di_temporal": False}, {"di_spatial": False}, {"permutation_sampling": False},
    {"spatial_radius_halving": False}, {"jitter": True},
], ids=lambda settings: next(iter(settings)))  # fmt: skip
def test_other_options_do_not_change_the_mean(device, cornell, settings):
    scene, truth, _ = cornell
    bar = 0.02 if "jitter" in settings else 0.01  # the reference has no jitter
    assert_within(observe(device, scene, 8, **(LITTLE_REUSE | settings)), truth, bar)


def mixed_scene():
    """A glossy floor under a wide sun and lamps of different colors, one of them double-sided."""
    glossy = sv.Material(base_color=(0.5, 0.3, 0.7), perceptual_roughness=0.6, metallic=0.4)
    scene = sv.Scene(
        sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), material=glossy),
        sv.Instance(mesh=shapes.box((-1, 0.4, -0.2), (-0.6, 0.9, 0.5)), material=matte((0.2, 0.6, 0.9))),
        sv.DirectionalLight(direction=(0.5, -1, 0.1), illuminance=2.0, color=(1.0, 0.8, 0.2), angular_diameter=0.7),
    )
    for x, color in ((-0.8, (0.0, 4.0, 9.0)), (0.5, (6.0, 0.0, 0.5))):
        scene.add(sv.Instance(mesh=shapes.quad((x, 1.3, 0), (0.2, 0, 0), (0, 0, 0.4)), material=lamp(color)))
    double = lamp((0.5, 2.0, 0.5), double_sided=True)
    scene.add(sv.Instance(mesh=shapes.quad((0.9, 0.6, 0.4), (0, 0.2, 0), (0.2, 0, 0.2)), material=double))
    scene.add(sv.Camera.look_at((0, 1.8, 2.6), (0, 0.2, 0), vertical_fov=math.radians(50)))
    return scene


def test_suns_and_lamps_on_a_glossy_floor(device):
    """Direct light of both lobes is unbiased in each color channel."""
    scene = mixed_scene()
    truth = trace_centers(device, scene, 4096)
    observations = observe(device, scene, 96, light_tile_count=128, di_candidates=32, **LITTLE_REUSE)
    assert replicates(sixteenths(observations), sixteenths(truth), 0.01)[0] == 0
    for channel in range(3):
        assert_within(observations[..., channel], truth[..., channel], 0.02, f"channel {channel}")


def test_highlights_choose_their_lights(device):
    """On polished metal under small lamps, a target with the whole BRDF has far less noise than the diffuse target."""
    scene = mixed_scene()
    next(iter(scene)).material.update(perceptual_roughness=0.3, metallic=1.0)
    noise = {}
    with renderer_of(device, scene, **LITTLE_REUSE) as renderer:
        for target in ("brdf", "matte"):
            renderer.settings.di_target = target
            renderer.reset()
            frames = np.stack([renderer.render(scene.camera)["di_specular"].copy() for _ in range(48)])
            noise[target] = frames.astype(np.float64).var(axis=0).mean()
    print(noise)
    assert noise["brdf"] < 0.5 * noise["matte"]


@pytest.mark.slow  # close to one of 441 lamps, that lamp is sampled so seldom that 1 % takes thousands of frames
def test_many_lights(device):
    scene = many_lights()
    truth = trace_centers(device, scene, 4096)
    tiles_as_shipped = {"light_tile_count": 128, "light_tile_samples": 1024}
    observations = observe(device, scene, 400, di_candidates=32, **tiles_as_shipped, **LITTLE_REUSE)
    assert_within(observations, truth, 0.01)


def test_smooth_surfaces_leave_their_specular_light_to_rays(device):
    scene = mixed_scene()
    with renderer_of(device, scene, specular_di_roughness=0.5) as renderer:
        frame = renderer.render(scene.camera)
        floor = frame["gbuffer_surface"][..., 1] == 0
        smooth = frame["di_specular"][floor].sum()
        assert (frame["di_diffuse"] > 0).any()
        renderer.settings.specular_di_roughness = 0.3
        rough = renderer.render(scene.camera)["di_specular"][floor].sum()
    assert smooth == 0, "the floor's roughness is 0.36"
    assert rough > 0


def test_confidence_is_capped_and_reset(device):
    scene = cornell_box()
    with renderer_of(device, scene, di_confidence_cap=6.0, di_spatial=False) as renderer:
        for _ in range(10):
            frame = renderer.render(scene.camera)
        confidence, exists = frame["di_reservoirs"]["confidence"], frame["gbuffer_depth"][..., 0] > 0
        assert confidence.max() == 7
        assert np.median(confidence[exists]) == 7
        assert (confidence[~exists] == 0).all()
        renderer.reset()
        assert (renderer.render(scene.camera)["di_reservoirs"]["confidence"][exists] == 1).all()


def test_halving_the_radius_finds_more_neighbors(device):
    scene = many_lights(sphere_count=16, box_count=400, extent=12.0, sphere_segments=6)
    missing = {}
    for halving in (True, False):
        with renderer_of(device, scene, (96, 96), spatial_radius_halving=halving) as renderer:
            frame = renderer.render(scene.camera)
            neighbors = frame["di_outcomes"][..., 0][frame["gbuffer_depth"][..., 0] > 0]
            missing[halving] = (neighbors == NO_INDEX).mean()
    assert missing[True] < 0.9 * missing[False]
