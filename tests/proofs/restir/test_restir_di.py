"""ReSTIR DI against the path tracer in light, penumbra and shadow; options that don't change the mean; history."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from support.frames import (
    DIRECT_ONLY,
    JITTER_PERIOD,
    Effort,
    direct_light,
    make_renderer,
    observe_runs,
    path_traced,
    path_tracer_at_centers,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import compare_runs, measure_mean, measure_picture_tiles, relative_interval, tile_means_4x4

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, many_lights, matte
from solari_vk.scene.matrices import transform_directions

DIRECT = Rule("direct light of a Cornell box")
SIXTEENTHS = Rule("direct light of a Cornell box in each of 4 x 4 tiles")
LIT = Rule("direct light where all of the lamp is seen")
PENUMBRA = Rule("direct light where part of the lamp is seen")
SHADOW = Rule("no direct light where nothing of the lamp is seen")
_SHARE_RAYS = 64  # pairs of a point in the pixel and one on the lamp


class Profile(NamedTuple):
    """The picture's width and height in pixels, the effort of the measurement, and the bars."""

    side: int
    effort: Effort
    bars: dict


BARS = {DIRECT: 0.005, SIXTEENTHS: 0.05, LIT: 0.01, PENUMBRA: 0.01, SHADOW: 0.005}
FULL = Profile(96, Effort(16, 24, 4 * JITTER_PERIOD, 2048), BARS)


def find_lit_share(device, scene, side):
    """How much of the lamp a pixel's surface sees (side, side), by rays; NaN where it faces away from it."""
    light = scene.instances["lamp"].mesh.positions.astype(np.float64)
    random, camera = np.random.default_rng(0), scene.camera
    pixels = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)[:, :, None]
    ndc = 2 * (pixels + random.random((side, side, _SHARE_RAYS, 2))) / side - 1
    slope = math.tan(camera.vertical_fov / 2) * np.array((1.0, -1.0))
    view = np.concatenate([ndc * slope, np.full((*ndc.shape[:3], 1), -1.0)], axis=-1)
    with sv.RayTracer(device, scene) as rays:
        hits = rays.trace(camera.transform[:3, 3], transform_directions(camera.transform, view))
        origins = hits["position"] + 1e-4 * hits["normal"]
        to_light = random.uniform(light.min(axis=0), light.max(axis=0), (*ndc.shape[:3], 3)) - origins
        facing = np.isfinite(hits["t"]) & ((to_light * hits["normal"]).sum(axis=-1) > 1e-2)
        seen = np.isinf(rays.trace(origins, to_light, t_max=1 - 1e-4, any_hit=True)["t"])
    with np.errstate(invalid="ignore"):
        return (facing & seen).sum(axis=-1) / facing.sum(axis=-1)


def trace_direct(device, scene, samples, side):
    """The path tracer's picture (side, side, 3) of one bounce, and which pixels (side, side) show no part of a lamp.

    Pixels at a lamp's edges are made black, because there the 32 jitter positions of the realtime frame cover a few per
    cent more of the lamp than the whole pixel does.
    """
    one, none = (path_traced(device, scene, samples, (side, side), max_bounces=count) for count in (1, 0))
    shown = (none == 0).all(axis=-1)
    return one * shown[..., None], shown


def observe_direct(device, scene, side, effort, **settings):
    """Direct light of independent runs (runs, side, side, 3)."""
    with make_renderer(device, scene, (side, side), **DIRECT_ONLY, **settings) as renderer:
        return observe_runs(renderer, scene.camera, effort, direct_light)


def measure_direct(device, profile):
    """Compares direct light with one bounce of the path tracer: in all pixels, and by the visible share of the lamp."""
    side, effort, bars = profile
    scene = cornell_box()
    expected, shown = trace_direct(device, scene, effort.samples, side)
    found = observe_direct(device, scene, side, effort) * shown[..., None]
    yield measure_mean(DIRECT, found, expected, bars[DIRECT], effort)
    yield measure_picture_tiles(SIXTEENTHS, found, expected, bars[SIXTEENTHS], effort)
    share = np.where(shown, find_lit_share(device, scene, side), np.nan)
    for rule, pixels in ((LIT, share == 1), (PENUMBRA, (share > 0) & (share < 1))):
        yield measure_mean(rule, found[:, pixels], expected[pixels], bars[rule], effort)
    dark = share == 0
    left = float(found[:, dark].mean() / expected.mean()) if dark.sum() > 16 else math.inf
    yield Measurement(SHADOW, left, bars[SHADOW], f"of the picture's light, {effort}")


# ---- at the centers of pixels ------------------------------------------------------------------------

SIDE = 48
CENTERS = {"gbuffer": "traced", "jitter": False}  # samples lie at pixel centers, as in trace_centers
# Less reuse than by default: frames are less correlated, so that fewer of them suffice, and a bias would stay as large.
LITTLE_REUSE = {"di_confidence_cap": 4.0, "di_spatial_radius": 12.0}


def trace_centers(device, scene, samples):
    """The path tracer's direct light, with all samples at pixel centers, so that edges add no noise."""
    with path_tracer_at_centers():
        one, none = (path_traced(device, scene, samples, (SIDE, SIDE), max_bounces=count) for count in (1, 0))
    return one - none


@pytest.fixture(scope="module")
def cornell(device):
    """The Cornell box, its direct light, and the share of the lamp that each pixel sees."""
    scene = cornell_box()
    return scene, trace_centers(device, scene, 1024), find_lit_share(device, scene, SIDE)


def renderer_of(device, scene, size=(SIDE, SIDE), **settings):
    return make_renderer(device, scene, size, **DIRECT_ONLY, **(CENTERS | settings))


def observe(device, scene, observed=16, **settings):
    """The mean of the last `observed` frames in each of 16 independent runs, (16, SIDE, SIDE, 3)."""
    return observe_direct(device, scene, SIDE, Effort(16, 24, observed), **(CENTERS | settings))


def assert_within(observations, truth, bar, what=""):
    error, half_width = relative_interval(observations, truth)
    assert abs(error) + half_width <= bar, f"{what}: {100 * error:+.2f} % +- {100 * half_width:.2f} %"


@pytest.mark.slow
def test_no_sixteenth_of_a_cornell_box_differs(device, cornell):
    """No tile of 4 x 4 differs from the path tracer."""
    scene, truth, _ = cornell
    assert compare_runs(tile_means_4x4(observe(device, scene, 32)), tile_means_4x4(truth), 0.01) == (0, True)


@pytest.mark.slow  # takes two thousand frames
def test_light_penumbra_and_shadow(device):
    require(measure_direct(device, FULL))


@pytest.mark.slow
def test_initial_visibility_is_biased(device, cornell):
    """Testing the visibility of samples before they are merged, as Solari does, loses light, mostly in penumbras."""
    scene, truth, share = cornell
    observations = observe(device, scene, 8, di_initial_visibility=True)
    penumbra = (share > 0) & (share < 1)
    for pixels, low, high in ((share >= 0, -0.10, -0.03), (penumbra, -0.35, -0.12)):
        error, half_width = relative_interval(observations[:, pixels], truth[pixels])
        assert low < error - half_width
        assert error + half_width < high


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"di_temporal": False},
        {"di_spatial": False},
        {"permutation_sampling": False},
        {"spatial_radius_halving": False},
        {"jitter": True},
    ],
    ids=lambda settings: next(iter(settings)),
)
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


@pytest.mark.slow
def test_suns_and_lamps_on_a_glossy_floor(device):
    """Direct light of both lobes is unbiased in each color channel."""
    scene = mixed_scene()
    truth = trace_centers(device, scene, 4096)
    observations = observe(device, scene, 96, light_tile_count=128, di_candidates=32, **LITTLE_REUSE)
    assert compare_runs(tile_means_4x4(observations), tile_means_4x4(truth), 0.01)[0] == 0
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
    observations = observe(device, scene, 900, di_candidates=32, **tiles_as_shipped, **LITTLE_REUSE)
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


def brief(device):
    """With less effort than the rules take: the bugs are larger than these bars."""
    return measure_direct(device, Profile(32, Effort(8, 12, JITTER_PERIOD, 512), dict.fromkeys(BARS, 0.15)))


@pytest.mark.slow
def test_brief_check_holds(device):
    require(brief(device))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        DIRECT: (
            brief,
            Bug(
                "passes/solari019/restir_di/initial_and_temporal.glsl",
                "generate_initial_reservoir",
                "DiReservoir reservoir = correct(pixel, surface, rng); "
                "reservoir.unbiased_contribution_weight *= float(restir_di_settings.candidates); return reservoir;",
            ),
        ),
        SHADOW: (brief, Bug("passes/solari019/restir_di/spatial_and_shade.comp", "transmittance", "return vec3(1.0);")),
    }
)
