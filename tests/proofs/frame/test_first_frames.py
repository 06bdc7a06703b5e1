"""First frames: a cold world cache is filled, edges are smooth, the blur shows no squares; a jump keeps what holds."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene.builtin import builtin

SIZE = (64, 64)
SEEDS = 8
DENOISED = {"denoise": True, "antialiasing": True, "jitter": True}
STEPS = (2, 4, 8, 16)  # of the blur's passes, in pixels: patterns that it makes have these periods


def truth(device, scene):
    """Two pictures of the path tracer with independent noise."""
    pictures = []
    with PathTracer(device, scene, SIZE) as tracer:
        for tracer.seed in (1, 2):
            pictures.append(tracer.render(samples=192)["radiance"])
    return pictures


def first_frames(device, scene, name="radiance"):
    """Of independent runs."""
    with make_renderer(device, scene, SIZE, **DENOISED) as renderer:
        for renderer.seed in range(SEEDS):
            renderer.reset()
            yield np.asarray(renderer.render()[name])


def mean_error(pictures, truth):
    return float(np.mean([true_relative_mse(picture, *truth) for picture in pictures]))


def test_edges_are_smooth(device):
    """relMSE 0.018; without the rays at edges 0.07."""
    scene = builtin("cornell_box")
    assert mean_error(first_frames(device, scene), truth(device, scene)) < 0.035


def test_paths_of_a_first_frame_end_in_the_cache(device):
    """Cells that the first frame has filled have light of several samples, and later rays are few."""
    with make_renderer(device, builtin("rooms"), SIZE, **DENOISED) as renderer:
        renderer.render()
        samples = renderer._frame["world_cache_irradiance"][:, 3]
    assert (samples >= 2.0).sum() > 300


@pytest.mark.slow
def test_the_mean_of_first_frames_is_right(device):
    scene = builtin("cornell_box")
    first, second = truth(device, scene)
    frames = [frame.mean() for frame in first_frames(device, scene, "raw_radiance")]
    expected = 0.5 * (first.mean() + second.mean())
    assert abs(np.mean(frames) / expected - 1) < 0.02 + 3 * np.std(frames) / expected / SEEDS**0.5


def test_the_blur_shows_no_squares(device):
    """In the spectrum of a dark room's errors the periods of the blur's steps stand out from those beside them by at
    most 11 %."""
    scene = builtin("rooms")
    expected = np.mean(truth(device, scene), axis=0).mean(axis=-1)
    spectrum = np.zeros(SIZE[0])
    for frame in first_frames(device, scene):
        error = frame.mean(axis=-1) / (expected + 0.05 * expected.mean()) - 1
        power = np.abs(np.fft.fft2(np.clip(error, -0.5, 0.5))) ** 2
        power[0, 0] = 0
        spectrum += power.sum(axis=0) + power.sum(axis=1)
    for step in STEPS:
        at = SIZE[0] // step
        beside = [spectrum[other] for other in range(at - 3, at + 4) if other != at and 0 < other <= SIZE[0] // 2]
        assert spectrum[at] < 1.3 * np.mean(beside), f"squares of {step} pixels"


def test_a_jump_keeps_the_cache_and_what_was_seen(device):
    """A frame after a jump of the camera, of which nobody was told, is better than after a reset, and no worse where
    the camera has turned around; and the cells are still there."""
    scene = builtin("rooms")
    expected = truth(device, scene)
    right, up, back, eye = scene.camera.transform.T[:, :3]
    same = {"up": up, "vertical_fov": scene.camera.vertical_fov, "ev100": scene.camera.ev100}
    beside = sv.Camera.look_at(eye + 0.2 * right, eye - back + 0.3 * right, **same)
    behind = sv.Camera.look_at(eye, eye + back, **same)
    with make_renderer(device, scene, SIZE, **DENOISED) as renderer:
        after_reset = mean_error(first_frames(device, scene), expected)
        for camera, bar in ((beside, 1.0), (behind, 1.2)):
            errors = []
            for renderer.seed in range(4):
                renderer.reset()
                for _ in range(10):
                    renderer.render(camera)
                cells = (renderer._frame["world_cache_irradiance"][:, 3] > 0).sum()
                errors.append(true_relative_mse(np.asarray(renderer.render(scene.camera)["radiance"]), *expected))
                assert (renderer._frame["world_cache_irradiance"][:, 3] > 0).sum() > 0.75 * cells
            assert np.mean(errors) < bar * after_reset


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "edges: no rays": (test_edges_are_smooth, Bug("passes/taa/find_edges.comp", "is_at_edge", "return false;")),
        "fill: nobody asks": (
            test_paths_of_a_first_frame_end_in_the_cache,
            Bug("passes/world_cache/request.comp", "ask_for_cell", ""),
        ),
        "blur: without its first passes": (
            test_the_blur_shows_no_squares,
            Bug("passes/denoise/blur.comp", "mean", "if (level < 3u) { return center; } return correct(sum, center);"),
        ),
        "jump: an old picture": (
            test_a_jump_keeps_the_cache_and_what_was_seen,
            Bug("passes/taa/constants.glsl", "JUMP", "1e9"),
        ),
    }
)
