"""The mean of whole frames against the path tracer, over independent runs: no light is lost, added or leaked."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import each_lighting
from support.measured import hold

import solari_vk as sv
from solari_vk.conformance import frame_checks, world_cache_checks
from solari_vk.conformance.frame_checks import TILES, WHOLE
from solari_vk.conformance.realtime import (
    SPLIT,
    Effort,
    add_up,
    make_renderer,
    measure_mean,
    measure_picture_tiles,
    run_pictures,
    trace,
    trace_reflected,
)
from solari_vk.measure.claims.scenes import ball_in_white
from solari_vk.measure.statistics import sixteenths
from solari_vk.scene.builtin import cornell_box


@pytest.mark.slow  # many cells
@each_lighting
def test_lights_off_in_a_sphere_grid(device, lighting):
    scene = sv.builtin("sphere_grid")
    with make_renderer(device, scene, **lighting) as renderer:
        for _ in range(20):
            renderer.render(scene.camera)
        hold(frame_checks.measure_lights_off(renderer, scene))


@pytest.mark.slow  # takes minutes each: these walls need more paths
@each_lighting
@pytest.mark.parametrize("walls", [name for name in frame_checks.BOXES if name not in frame_checks.QUICK_BOXES])
def test_energy_is_kept_in_a_closed_glossy_box(device, walls, lighting):
    hold(frame_checks.measure_closed_box(device, walls, Effort(16, 24, 96, 256), **lighting))


@pytest.mark.slow  # the conformance suite measures the default lighting
@pytest.mark.parametrize("check", [
    lambda device, **split: frame_checks.measure_closed_box(device, "matte", **split),
    lambda device, **split: frame_checks.measure_closed_box(device, "mirror", **split),
    frame_checks.measure_light, frame_checks.measure_determinism, frame_checks.measure_finite,
    world_cache_checks.measure_fixed_point, world_cache_checks.measure_leak,
], ids=["matte_box", "mirror_box", "light", "determinism", "finite", "fixed_point", "leak"])  # fmt: skip
def test_separate_passes_keep_the_same_rules(device, check):
    hold(check(device, **SPLIT))


def of_ball(frame):
    """The mean radiance (3,) of the pixels whose surface doesn't emit."""
    return frame["radiance"][~frame["emission"][..., :3].any(axis=-1)].mean(axis=0)


# Perceptual roughness and metallic of a ball, the number of runs, the frames of each run, and the bar. Mirrors need few
# frames, because each of their rays has the white sky's radiance. Diffuse balls take a minute each and are slow tests.
BALLS = {
    "mirror": (0.0, 1.0, 4, 8, 1e-3), "smooth metal": (0.1, 1.0, 8, 32, 2e-3), "matte": (1.0, 0.0, 16, 64, 0.03),
    "plastic": (0.4, 0.0, 16, 64, 0.03), "lacquer": (0.0, 0.0, 16, 64, 0.03), "rough metal": (0.8, 1.0, 16, 64, 0.03),
}  # fmt: skip


@each_lighting
@pytest.mark.parametrize(
    "ball", [pytest.param(name, marks=[pytest.mark.slow] if row[2] > 8 else []) for name, row in BALLS.items()]
)
def test_white_furnace(device, ball, lighting):
    """A white ball has the radiance of the white sky around it: the frame neither adds nor loses light."""
    roughness, metallic, runs, observed, bar = BALLS[ball]
    scene, effort = ball_in_white(roughness, metallic), Effort(runs, 24, observed)
    with make_renderer(device, scene, world_cache_cell_size=4.0, **lighting) as renderer:
        found = run_pictures(renderer, scene.camera, effort, of_ball)
    hold([measure_mean(WHOLE, found, 1.0, bar, effort)])


@pytest.mark.slow  # takes over a minute of processor time: tens of thousands of cells and three million paths
@each_lighting
@pytest.mark.parametrize("name", ["sphere_grid", "mirror_hall"])
def test_glossy_scenes(device, name, lighting):
    """The denoiser gets a larger picture: it blurs the light of what is few pixels wide."""
    size, runs = ((96, 96), 4) if lighting.get("denoise") else ((32, 32), 16)
    scene, effort = sv.builtin(name), Effort(runs, 24, 12)
    expected = trace(device, scene, 512, size, max_bounces=64)
    with make_renderer(device, scene, size, **lighting) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda frame: frame["radiance"])
    tiles = measure_picture_tiles(TILES, found, expected, 0.12, effort)
    hold([measure_mean(WHOLE, found, expected, 0.05, effort), tiles])


@pytest.mark.slow
def test_undivided_cells_leak(device):
    """A control of conformance's rule about leaks: with undivided cells its measurement fails."""
    (leak,) = world_cache_checks.measure_leak(device, [(0.075, 0, 0.002)], world_cache_leak_prevention="finest")
    assert not leak.holds


@pytest.mark.slow
@each_lighting
def test_an_overfull_cache_shows_no_patches(device, lighting):
    """With more cells than the map holds, no tile loses its light, and no light is added."""
    scene, size = cornell_box(), (64, 64)
    expected = trace_reflected(device, scene, 256, size)
    cells = sv.Settings().world_cache_cells
    with make_renderer(device, scene, size, **lighting, world_cache_cells=cells, world_cache_cell_size=0.001,
                       world_cache_update_cap=cells, world_cache_lifetime=100) as renderer:  # fmt: skip
        for _ in range(16):
            renderer.render(scene.camera)
        assert np.mean(renderer["world_cache_life"] > 0) > 0.9
        assert renderer["world_cache/insert_failures"] > 1000
        picture = np.mean([add_up(renderer.render(scene.camera)) for _ in range(4)], axis=0)
    picture[(expected == 0).all(axis=-1)] = 0
    there = sixteenths(expected).mean(axis=-1) > 0
    ratio = sixteenths(picture).mean(axis=-1)[there] / sixteenths(expected).mean(axis=-1)[there]
    assert np.isfinite(picture).all()
    assert ratio.min() > 0.8, "a patch of the picture lost its light"
    assert 0.9 < picture.mean() / expected.mean() < 1.05
