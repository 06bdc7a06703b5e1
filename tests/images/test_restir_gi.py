"""ReSTIR GI by itself: without the world cache it is one indirect bounce, which the path tracer knows exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.replication import observe_runs
from solari_vk.measure.statistics import holm, relative_interval, sixteenths
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import closed_box, cornell_box, place
from solari_vk.scene.model import Instance, Material
from solari_vk.scene.shapes import sphere
from solari_vk.settings import Settings

SIZE = (32, 32)
# What else a frame does is kept small.
ALONE = {"world_cache": False, "world_cache_cells": 1024, "di": False, "specular": False, "light_tile_count": 1,
         "light_tile_samples": 1, "gbuffer": "traced", "lambert": True}  # fmt: skip


def make_renderer(device, scene, size=SIZE, **settings):
    return Renderer(device, scene, size, Settings(**{**ALONE, **settings}))


def second_bounce(device, scene, samples, seeds=4):
    """What the path tracer finds with two bounces and not with one, in independent runs (seeds, h, w, 3)."""
    return np.array([
        _picture(device, scene, samples, seed, 2) - _picture(device, scene, samples, seed, 1) for seed in range(seeds)
    ])  # fmt: skip


def _picture(device, scene, samples, seed, bounces):
    tracer = PathTracer(device, scene, SIZE, max_bounces=bounces, lambert=True, seed=seed)
    try:
        return tracer.render(scene.camera, samples)["radiance"].astype(np.float64)
    finally:
        tracer.close()


def assert_same_means(observations, reference, bar):
    """P-REPL: no tile nor the whole differs at 0.005 by Holm, and the whole's 95 % interval lies within the bar."""
    error, half_width = relative_interval(observations, reference)
    found, truth = (np.concatenate([sixteenths(x).mean(-1).reshape(len(x), -1), x.mean((1, 2, 3))[:, None]], axis=1)
                    for x in (observations, reference))  # fmt: skip
    p_values = stats.ttest_ind(found, truth, equal_var=False).pvalue
    what = f"{100 * error:+.2f} % +- {100 * half_width:.2f} %, smallest p {p_values.min():.2g}"
    assert not holm(p_values, 0.005).any(), what
    assert abs(error) + half_width <= bar, what


@pytest.fixture(scope="module")
def cornell(device):
    scene = cornell_box()
    return scene, second_bounce(device, scene, 512)


def observe(device, scene, observed=48, **settings):
    with make_renderer(device, scene, **settings) as renderer:
        return observe_runs(renderer, scene.camera, "gi_diffuse", observed=observed)


def test_one_bounce_is_the_path_tracers(device, cornell):
    scene, reference = cornell
    assert_same_means(observe(device, scene), reference, 0.03)


def test_visibility_as_in_solari_loses_light(device, cornell):
    scene, reference = cornell
    error, half_width = relative_interval(observe(device, scene, 16, gi_visibility="neighbor"), reference)
    assert error + half_width < -0.03


@pytest.mark.parametrize(("temporal", "spatial"), [(False, False), (True, False), (False, True)])
def test_each_reuse_alone_is_the_path_tracers(device, cornell, temporal, spatial):
    scene, reference = cornell
    observations = observe(device, scene, 16, gi_temporal=temporal, gi_spatial=spatial)
    assert_same_means(observations, reference, 0.04)


@pytest.mark.slow
def test_one_bounce_within_less_than_a_percent(device):
    scene = cornell_box()
    reference = second_bounce(device, scene, 4096)
    assert_same_means(observe(device, scene, 400), reference, 0.0075)


def test_skipping_smooth_metals_leaves_no_trace(device):
    scene = closed_box()  # no wall's plane meets the sphere, so that no wall reuses its samples
    metal = Material(base_color=(0.9, 0.6, 0.3), metallic=1.0, perceptual_roughness=0.2)
    scene.add(Instance(mesh=sphere(), material=metal, transform=place(0.3, at=(-0.2, -0.1, -0.3))))
    found, confidence = [], []
    for skip in (True, False):
        with make_renderer(device, scene, lambert=False, gi_skip_smooth_metals=skip) as renderer:
            for _ in range(6):
                frame = renderer.render(scene.camera)
            found.append(frame["gi_diffuse"])
            confidence.append(frame["gi_reservoirs"]["confidence_weight"])
    skipped = (confidence[0] == 0) & (confidence[1] > 0)
    assert skipped.sum() > 20, f"the sphere is in {skipped.sum()} pixels"
    assert not found[1][skipped].any()
    assert np.array_equal(*found)


def test_confidence_grows_to_its_cap_and_starts_anew(device):
    scene = cornell_box()
    with make_renderer(device, scene, gi_spatial=False, gi_confidence_cap=5.0) as renderer:
        for count in range(1, 10):
            confidence = renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"]
            assert confidence.max() == min(count, 6)
        renderer.reset()
        assert set(np.unique(renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"])) <= {0, 1}


def test_one_seed_gives_one_picture(device):
    scene = cornell_box()
    found = []
    for _ in range(2):
        with make_renderer(device, scene) as renderer:
            for _ in range(4):
                found.append(renderer.render(scene.camera)["gi_diffuse"])
    assert np.array_equal(found[:4], found[4:])
    assert not np.array_equal(found[0], found[1])


def test_off_is_nothing_at_all(device):
    scene = cornell_box()
    with make_renderer(device, scene) as renderer:
        renderer.render(scene.camera)
        renderer.settings.gi = False
        frame = renderer.render(scene.camera)
        assert not frame["gi_diffuse"].any()
        assert not frame["gi_reservoirs"]["confidence_weight"].any()
        renderer.settings.gi = True
        assert renderer.render(scene.camera)["gi_diffuse"].any()


INITIAL, SHADE = "passes/restir_gi/initial_and_temporal.comp", "passes/restir_gi/spatial_and_shade.comp"
QUERY = "passes/world_cache/query.glsl"
MUTANTS = {
    "rays of the previous frame's surfaces hit them":
        (INITIAL, "neighbor_surface.ray_offset = surface.ray_offset;", ""),
    "density of another distribution": (INITIAL, "? 2.0 * PI :", "? PI / 0.6 :"),
    "radiance where irradiance is": (QUERY, "vec3 reflectance = INVERSE_PI * ", "vec3 reflectance = "),
    "contribution weight forgotten": (SHADE, "* reservoir.unbiased_contribution_weight", ""),
    "own sample merged twice":
        (SHADE, "gi_temporal_reservoirs.at[neighbor.y * camera.size.x + neighbor.x]", "reservoir"),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if i else []) for i, n in enumerate(MUTANTS)]
)
def test_seeded_bug_is_noticed(device, cornell, name):
    scene, reference = cornell
    with patched_shaders(MUTANTS[name]):
        observations = observe(device, scene, 16)
    with pytest.raises(AssertionError):
        assert_same_means(observations, reference, 0.05)
