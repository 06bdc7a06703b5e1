"""Scenes on which light sampling, caches and reuse go wrong: lamps beside surfaces, shiny floors, any scale, motion.

The mean of the frames is the path tracer's, and no pixel is far too bright.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.assets import asset
from support.frames import TILES, WHOLE, left_of, settle
from support.measured import hold
from support.realtime import (
    Effort,
    make_renderer,
    measure_mean,
    measure_picture_tiles,
    run_pictures,
    trace,
)
from support.replication import replicate

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

OUTLIERS = Rule("no pixel without the lamp is brighter than the lamp in the mean of 16 frames", SUITE, "Renderer")
BALLS = Rule("the indirect light of balls is the path tracer's", SUITE, "Renderer")

SIZE = (48, 48)

pytestmark = pytest.mark.parametrize("lighting", [
    pytest.param({}, id="default"), pytest.param({"restir": True}, id="reuse", marks=pytest.mark.slow),
])  # fmt: skip


def scaled(scene, factor):
    """The same scene, `factor` times as large around the origin."""
    grow = np.diag((factor, factor, factor, 1.0))
    for instance in scene:
        instance.transform = grow @ instance.transform
    return scene


def radiance(frame):
    return np.asarray(frame["radiance"], np.float64)


# ---- lamps beside surfaces --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_lamp_under_the_ceiling_of_a_huge_room(device, lighting, scale):
    """The file's room is 550 m wide. Its lamp hangs 0.9 m below the ceiling and emits on both sides. At a hundredth of
    this size the picture is the same.

    Pixels that show the lamp are left out: they would hold a third of the light, with the error of 32 sample positions.
    """
    scene = scaled(sv.load_gltf(asset("CornellBox/CornellBox.glb")), scale)
    scene.add(sv.Camera.framing(scene.bounds, (0, 0, -1)))
    effort = Effort(16, 24, 64)
    expected = trace(device, scene, 4096, SIZE, seed=9)

    with make_renderer(device, scene, SIZE, **lighting) as renderer:

        def means_of_16():
            settle(renderer, scene.camera, effort.warm_up)
            return [np.mean([radiance(renderer.render(scene.camera)) for _ in range(16)], axis=0) for _ in range(4)]

        blocks = replicate(renderer, effort.runs, means_of_16)
    lamp_radiance = expected.max()
    dark = trace(device, scene, 256, SIZE, max_bounces=0) == 0
    blocks, expected = blocks * dark, expected * dark
    found, outlier = blocks.mean(axis=1), float(blocks.max() / lamp_radiance)
    hold([
        measure_mean(WHOLE, found, expected, 0.02, effort), measure_picture_tiles(TILES, found, expected, 0.1, effort),
        Measurement(OUTLIERS, outlier, 1.0, "times the lamp's radiance"),
    ])  # fmt: skip


@pytest.mark.parametrize("gap", [0.01, pytest.param(0.1, marks=pytest.mark.slow)])
def test_a_lamp_close_to_the_ceiling(device, lighting, gap):
    scene, effort = sv.builtin("lamp_gap", gap=gap), Effort(16, 24, 32)
    expected = trace(device, scene, 2048, SIZE, seed=9)
    with make_renderer(device, scene, SIZE, **lighting) as renderer:
        found = run_pictures(renderer, scene.camera, effort, radiance)
    hold([measure_mean(WHOLE, found, expected, 0.02, effort)])


# ---- shiny floors -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_sun_on_a_shiny_floor(device, lighting):
    """The frame is as bright as the path tracer's, and so is the indirect light of all balls, and less exactly that of
    the ball over each roughness: what remains of their light without the path tracer's direct light."""
    scene, effort = sv.builtin("shiny_floor"), Effort(16, 24, 96)
    expected = trace(device, scene, 4096, SIZE, seed=9)
    direct = trace(device, scene, 1024, SIZE, max_bounces=1, seed=9)
    with make_renderer(device, scene, SIZE, **lighting) as renderer:
        found = run_pictures(renderer, scene.camera, effort, radiance)
        frame = renderer.render(scene.camera)
        balls = [frame.mask(f"ball {i}") for i in range(3)]

    def measure_indirect(mask, bar):
        assert (expected - direct)[mask].mean() > 0.1 * direct[mask].mean(), "there is little indirect light"
        return measure_mean(BALLS, (found - direct)[:, mask], (expected - direct)[mask], bar, effort)

    hold([
        measure_mean(WHOLE, found, expected, 0.03, effort), measure_indirect(np.any(balls, axis=0), 0.05),
        *(measure_indirect(ball, 0.1) for ball in balls),
    ])  # fmt: skip


# ---- motion -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_shadow_moves_with_its_object(device, lighting):
    """One frame after an object under a lamp has jumped, less than 15 % of the change of the light around it is
    missing. `left_of` measures this; the frames are means over independent runs."""
    floor = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), material=matte(0.6), name="floor")
    plate = sv.Instance(mesh=shapes.box((-0.5, 0.9, -0.5), (0.5, 1.0, 0.5)), material=matte(0.4), name="plate")
    light = sv.Instance(mesh=shapes.facing_quad((0, 4, 0.01), 0.3), material=lamp(40.0))
    scene = sv.Scene(floor, plate, light)
    camera = sv.Camera.look_at((0, 4, 5), (0, 0, 0))
    places = [place(at=(x, 0, 0)) for x in (-0.9, 0.9)]
    expected = []
    for at in places:
        plate.transform = at
        expected.append(trace(device, scene, 1024, SIZE, camera))
    moved = np.zeros_like(expected[0])
    with make_renderer(device, scene, SIZE, **lighting, jitter=False) as renderer:
        for seed in range(24):
            renderer.seed = seed
            renderer.reset()
            plate.transform = places[0]
            settle(renderer, camera, 24)
            plate.transform = places[1]
            moved += radiance(renderer.render(camera)) / 24
    on_floor = (np.abs(expected[0] - expected[1]).max(axis=-1) > 0.2 * expected[1].mean()) & (expected[1][..., 0] > 0)
    lag = left_of(expected[0][on_floor], expected[1][on_floor], moved[on_floor])
    print(f"{lag:.3f} of the change is missing, on {on_floor.mean():.0%} of the picture")
    assert on_floor.mean() > 0.02
    assert abs(lag) < 0.15
