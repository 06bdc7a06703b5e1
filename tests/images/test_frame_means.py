"""The whole frame against the path tracer: no light lost, none made, none that leaks; replicated runs (P-REPL)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from whole_frames import SIZE, find, make_renderer, reflected, reflected_truth, truth

import solari_vk as sv
from solari_vk.measure.claims.scenes import ball_in_white
from solari_vk.measure.replication import observe_runs
from solari_vk.measure.statistics import relative_interval, sixteenths
from solari_vk.scene.builtin import closed_box, cornell_box, place, rgb

JITTER_PERIOD = 32  # frames after which samples have been all over the pixel: edges then add no noise


def check(device, scene, expected, bar, size=SIZE, runs=16, observed=JITTER_PERIOD, read="radiance", **settings):
    """The 95 % interval of the global mean's relative error lies within the bar. Returns what was observed."""
    with make_renderer(device, scene, size, **settings) as renderer:
        observations = observe_runs(renderer, scene.camera, read, runs=runs, observed=observed)
    error, half_width = relative_interval(observations, expected)
    what = f"{100 * error:+.2f} % +- {100 * half_width:.2f} %"
    print(what)
    assert abs(error) + half_width <= bar, what
    return observations


def check_tiles(observations, expected, bar):
    """Each of 16 tiles' relative error lies within the bar."""
    errors = sixteenths(observations).mean(axis=(0, -1)) / sixteenths(expected).mean(axis=-1) - 1
    print(f"worst tile {100 * np.abs(errors).max():.2f} %")
    assert np.abs(errors).max() <= bar, f"\n{np.round(100 * errors, 1)}"


def test_cornell_box(device):
    """Where no lamp is seen: half of the picture's light is that of the lamp's own pixels, which would hide errors of
    the rest: at its edges, the pattern of 32 samples within a pixel covers 1 % less of it than it should."""
    scene = cornell_box()
    expected = reflected_truth(device, scene, 4096)
    without_lamp = (expected > 0).any(axis=-1, keepdims=True)
    found = check(device, scene, expected, bar=0.02, read=lambda frame: reflected(frame) * without_lamp)
    check_tiles(found, expected, bar=0.05)


# perceptual roughness and metallic of walls that emit 1 and reflect about half
WALLS = {"matte": (1.0, 0.0), "plastic": (0.3, 0.0), "rough metal": (0.7, 1.0), "glossy metal": (0.3, 1.0),
         "mirror": (0.0, 1.0)}  # fmt: skip


# Slow: those between the extremes, seconds each.
@pytest.mark.parametrize(
    "walls", [pytest.param(name, marks=[] if name in ("matte", "mirror") else [pytest.mark.slow]) for name in WALLS]
)
def test_energy_is_never_created_in_a_closed_box(device, walls):
    scene = closed_box()
    roughness, metallic = WALLS[walls]
    material = next(iter(scene)).material
    material.update(perceptual_roughness=roughness, metallic=metallic)
    if walls != "matte":
        material.reflectance = rgb(0.5)
    size = (16, 16)
    expected = truth(device, scene, 256, size=size, max_bounces=64)
    seeds, observed = (8, 16) if walls in ("matte", "mirror") else (16, 96)  # the others' paths are noisier
    found = check(device, scene, expected, bar=0.03, size=size, runs=seeds, observed=observed)
    check_tiles(found, expected, bar=1.0)


def of_ball(frame):
    """The mean of what is seen of things that don't glow, where a pixel shows nothing else."""
    return frame["radiance"][~frame["emission"][..., :3].any(axis=-1)].mean(axis=0)


# perceptual roughness and metallic of balls, runs, frames of each, and the bar. Mirrors need no average, for each of
# their rays has the white sky's radiance. Slow: a minute each.
BALLS = {
    "mirror": (0.0, 1.0, 4, 8, 1e-3), "smooth metal": (0.1, 1.0, 4, 8, 2e-3), "matte": (1.0, 0.0, 16, 64, 0.03),
    "plastic": (0.4, 0.0, 16, 64, 0.03), "lacquer": (0.0, 0.0, 16, 64, 0.03), "rough metal": (0.8, 1.0, 16, 64, 0.03),
}  # fmt: skip


@pytest.mark.parametrize(
    "ball", [pytest.param(name, marks=[pytest.mark.slow] if row[2] > 4 else []) for name, row in BALLS.items()]
)
def test_white_furnace(device, ball):
    """A white ball under a white sky can't be told from it: the frame neither makes light nor loses any."""
    roughness, metallic, seeds, observed, bar = BALLS[ball]
    scene = ball_in_white(roughness, metallic)
    check(device, scene, 1.0, bar, runs=seeds, observed=observed, read=of_ball, world_cache_cell_size=4.0)


@pytest.mark.slow  # over a minute of processor time: tens of thousands of cells and three million paths
@pytest.mark.parametrize("name", ["sphere_grid", "mirror_hall"])
def test_glossy_scenes(device, name):
    scene = sv.builtin(name)
    expected = truth(device, scene, 512, max_bounces=64)
    check_tiles(check(device, scene, expected, bar=0.05, observed=12), expected, bar=0.12)


def leak(device, x=0.0, turn=0.0, **settings):
    """Light in the dark half of a room over that in the lit one, behind a wall of 2 cm at x, turned about y by so many
    degrees."""
    scene = sv.builtin("thin_wall")
    find(scene, "wall").transform = place((1.0, 1.0, 4.0 if turn else 1.0), (x, 0, 0), math.radians(turn))
    dark = truth(device, scene, 64).max(axis=-1) == 0
    dark[:, : SIZE[0] // 2] = False  # what lies outside the room
    with make_renderer(device, scene, **settings) as renderer:
        for _ in range(24):
            renderer.render(scene.camera)
        picture = np.mean([reflected(renderer.render(scene.camera)) for _ in range(16)], axis=0)
    return picture[dark].mean() / picture[picture.max(axis=-1) > 0].mean()


@pytest.mark.parametrize(("x", "turn", "bar"), [
    (0.0, 0, 0.001), (0.03, 0, 0.002), (0.075, 0, 0.002), (0.1, 0, 0.002), (0.0, 45, 0.01), (0.05, 20, 0.01),
])  # fmt: skip
def test_nothing_leaks_through_a_thin_wall(device, x, turn, bar):
    """On the cells' grid, within a cell, right through its middle, across."""
    assert leak(device, x, turn) < bar


@pytest.mark.slow  # shows what the test above can miss
def test_without_prevention_light_leaks(device):
    """The bar above is one that can be missed."""
    assert leak(device, x=0.075, world_cache_leak_prevention="off") > 0.01


@pytest.mark.slow  # a million cells, each with two rays a frame
def test_an_overfull_cache_shows_no_patches(device):
    """More cells than the largest map of the defaults has: no tile is black, and no light is made."""
    scene, size = cornell_box(), (64, 64)
    expected = reflected_truth(device, scene, 256, size=size)
    cells = sv.Settings().world_cache_cells
    with make_renderer(device, scene, size, world_cache_cells=cells, world_cache_cell_size=0.001,
                       world_cache_update_cap=cells, world_cache_lifetime=100) as renderer:  # fmt: skip
        for _ in range(16):
            renderer.render(scene.camera)
        assert renderer["world_cache/active_cells"] > 0.9 * cells
        assert renderer["world_cache/insert_failures"] > 1000
        picture = np.mean([reflected(renderer.render(scene.camera)) for _ in range(4)], axis=0)
    picture[(expected == 0).all(axis=-1)] = 0
    there = sixteenths(expected).mean(axis=-1) > 0
    ratio = sixteenths(picture).mean(axis=-1)[there] / sixteenths(expected).mean(axis=-1)[there]
    assert np.isfinite(picture).all()
    assert ratio.min() > 0.8, "a patch of the picture lost its light"
    assert 0.9 < picture.mean() / expected.mean() < 1.05
