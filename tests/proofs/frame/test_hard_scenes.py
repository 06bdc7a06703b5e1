"""Scenes on which light sampling, caches and reuse go wrong: lamps beside surfaces, shiny floors, any scale.

The mean of the frames is the path tracer's, and no pixel is far too bright.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import TILES, WHOLE, Effort, make_renderer, observe_runs, path_traced, render_frames, replicate
from support.seeded_bugs import Measurement, Rule, require
from support.statistics import measure_mean, measure_picture_tiles

import solari_vk as sv

OUTLIERS = Rule("no pixel without the lamp is brighter than the lamp in the mean of 16 frames")
GLINTS = Rule("without regularization, the brightest samples of raw frames are at least the path tracer's")
BLURRED = Rule("regularization takes the peaks of glints, as docs/accuracy.md says")
BALLS = Rule("the indirect light of balls is the path tracer's")

SIZE = (48, 48)

pytestmark = [pytest.mark.slow, pytest.mark.parametrize("lighting", [{}, {"restir": True}], ids=["default", "reuse"])]


def radiance(frame):
    return np.asarray(frame["radiance"], np.float64)


# ---- lamps beside surfaces --------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_lamp_under_the_ceiling_of_a_huge_room(device, lighting, scale, asset):
    """The file's room is 550 m wide. Its lamp hangs 0.9 m below the ceiling and emits on both sides. At a hundredth of
    this size the picture is the same.

    Pixels that show the lamp are left out: they would hold a third of the light, with the error of 32 sample positions.
    """
    scene = sv.load_gltf(asset("CornellBox/CornellBox.glb"))
    for instance in scene:
        instance.transform = np.diag((scale, scale, scale, 1.0)) @ instance.transform
    scene.add(sv.Camera.framing(scene.bounds, (0, 0, -1)))
    effort = Effort(16, 24, 64)
    expected = path_traced(device, scene, 4096, SIZE, seed=9)

    with make_renderer(device, scene, SIZE, **lighting) as renderer:

        def means_of_16():
            render_frames(renderer, scene.camera, effort.warm_up)
            return [np.mean([radiance(renderer.render(scene.camera)) for _ in range(16)], axis=0) for _ in range(4)]

        blocks = replicate(renderer, effort.runs, means_of_16)
    lamp_radiance = expected.max()
    dark = path_traced(device, scene, 256, SIZE, max_bounces=0) == 0
    blocks, expected = blocks * dark, expected * dark
    found, outlier = blocks.mean(axis=1), float(blocks.max() / lamp_radiance)
    require(
        [
            measure_mean(WHOLE, found, expected, 0.02, effort),
            measure_picture_tiles(TILES, found, expected, 0.1, effort),
            Measurement(OUTLIERS, outlier, 1.0, "times the lamp's radiance"),
        ]
    )


@pytest.mark.parametrize("gap", [0.01, 0.1])
def test_a_lamp_close_to_the_ceiling(device, lighting, gap):
    scene = sv.builtin("lamp_gap", gap=gap)
    size = (24, 24)
    effort = Effort(12, 24, 16)
    expected = path_traced(device, scene, 2048, size, seed=9)
    with make_renderer(device, scene, size, **lighting) as renderer:
        found = observe_runs(renderer, scene.camera, effort, radiance)
    require([measure_mean(WHOLE, found, expected, 0.02, effort)])


# ---- shiny floors -----------------------------------------------------------------------------------


def test_the_sun_on_a_shiny_floor(device, lighting):
    """The frame is as bright as the path tracer's, and so is the indirect light of all balls, and less exactly that of
    the ball over each roughness: what remains of their light without the path tracer's direct light."""
    scene, effort = sv.builtin("shiny_floor"), Effort(16, 24, 96)
    expected = path_traced(device, scene, 4096, SIZE, seed=9)
    direct = path_traced(device, scene, 1024, SIZE, max_bounces=1, seed=9)
    with make_renderer(device, scene, SIZE, **lighting) as renderer:
        found = observe_runs(renderer, scene.camera, effort, radiance)
        frame = renderer.render(scene.camera)
        balls = [frame.mask(f"ball {i}") for i in range(3)]

    def measure_indirect(mask, bar):
        assert (expected - direct)[mask].mean() > 0.1 * direct[mask].mean(), "there is little indirect light"
        return measure_mean(BALLS, (found - direct)[:, mask], (expected - direct)[mask], bar, effort)

    require(
        [
            measure_mean(WHOLE, found, expected, 0.03, effort),
            measure_indirect(np.any(balls, axis=0), 0.05),
            *(measure_indirect(ball, 0.1) for ball in balls),
        ]
    )


def test_regularization_alone_takes_glints(device, lighting):
    """What a floor of nearly smooth metal throws onto a ball is rare and bright. No other limit takes it. The brightest
    of 350,000 samples has less than a quarter of the path tracer's by default, and all of it without regularization."""
    scene, size, count = sv.builtin("shiny_floor", roughness=[0.02]), (48, 36), 200

    def brightest(render):
        return float(max(np.max(render(number)["raw_radiance"]) for number in range(count)))

    with sv.PathTracer(device, scene, size) as tracer:

        def sample(number):
            tracer.seed = number
            return tracer.render(samples=1)

        expected = brightest(sample)
    found = []
    for least in ({}, {"paths_regularization": 0.0}):
        with make_renderer(device, scene, size, **lighting, **least) as renderer:
            found.append(brightest(lambda _, renderer=renderer: renderer.render(scene.camera)) / expected)
    require(
        [
            Measurement(BLURRED, found[0], 0.25, "of the path tracer's"),
            Measurement(GLINTS, 1 / found[1], 1.0, "of the path tracer's, inverted"),
        ]
    )
