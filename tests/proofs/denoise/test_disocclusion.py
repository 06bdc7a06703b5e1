"""Pixels that have come into view in the latest frames, beside those whose histories are long."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from support.frames import find, frames_in_history, path_tracer_at_centers
from support.realtime import make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene.builtin import builtin, place

SIZE = (96, 96)
FRAMES, SEEDS = 20, (31, 32)
YOUNG, SETTLED = 3.5, 15.5  # frames in a history: at most, and at least
BAR = 3.0  # error of new pixels over that of settled ones


def strafe(scene, step):
    """Moves the camera to the right, by about 6 pixels of what is in the middle of the scene."""
    camera = scene.camera
    moved = np.array(camera.transform)
    distance = np.linalg.norm(moved[:3, 3] - scene.bounds.center)
    pixel = 2 * distance * np.tan(camera.vertical_fov / 2) / SIZE[1]
    moved[:3, 3] += moved[:3, 0] * 6 * pixel * (step - FRAMES / 2)
    return sv.Camera(transform=moved, vertical_fov=camera.vertical_fov, near=camera.near, ev100=camera.ev100)


def slide(scene, step):
    """Moves the short block of a Cornell box to the left, by about 2 pixels."""
    find(scene, "short block").transform = place(at=(0.04 * (step - FRAMES / 2), 0.15, 0.0))
    return scene.camera


@dataclass
class Seen:
    """What the last frame shows, for all seeds: squared relative errors and the lengths of histories; and for the last
    four frames, whether pixels show the object that moves."""

    errors: np.ndarray
    lengths: np.ndarray
    object: np.ndarray


def watch(device, name, move):
    scene = builtin(name)
    pictures, lengths = [], []
    with make_renderer(device, scene, SIZE, denoise=True, jitter=False) as renderer:
        for seed in SEEDS:
            renderer.seed = seed
            renderer.reset()
            shown = []
            for step in range(FRAMES):
                frame = renderer.render(move(scene, step))
                shown.append(frame.mask("short block") if name == "cornell_box" else None)
            pictures.append(np.asarray(frame["radiance"], np.float64))
            lengths.append(frames_in_history(frame))
    with path_tracer_at_centers(), sv.PathTracer(device, scene, SIZE, seed=99) as tracer:
        truth = np.asarray(tracer.render(move(scene, FRAMES - 1), samples=512), np.float64)
    squares = (np.array(pictures) - truth) ** 2 / (truth**2 + 1e-2 * truth.mean() ** 2)
    return Seen(squares.mean(axis=-1), np.array(lengths), np.array(shown[-4:]))


def check_new_pixels(seen, new):
    """Require that the error of new pixels is not far above that of settled ones."""
    settled = (seen.lengths >= SETTLED) & ~new
    young, old = seen.errors[new].mean(), seen.errors[settled].mean()
    print(f"{new.sum()} new pixels, {young:.4f}; settled {old:.4f}: {young / old:.2f}")
    assert new.sum() > 50
    assert young / old < BAR


def check_moving_view(device, name="cornell_box"):
    """Pixels at the border, and beside objects that the camera passes."""
    seen = watch(device, name, strafe)
    check_new_pixels(seen, (seen.lengths > 0) & (seen.lengths <= YOUNG))


def check_moving_block(device):
    """Pixels that showed the block one to three frames ago."""
    seen = watch(device, "cornell_box", slide)
    new = seen.object[:-1].any(axis=0) & ~seen.object[-1]
    check_new_pixels(seen, np.broadcast_to(new, seen.errors.shape))


@pytest.mark.parametrize("name", ["cornell_box", *(pytest.param(n, marks=pytest.mark.slow)
                                                   for n in ("sphere_grid", "mirror_hall"))])  # fmt: skip
def test_what_comes_into_view(device, name):
    check_moving_view(device, name)


@pytest.mark.slow
def test_what_a_moving_block_uncovers(device):
    check_moving_block(device)


test_a_seeded_bug_is_noticed = bug_tests({
    "what comes into view: the blur leaves it out": (check_moving_view, Bug(
        "passes/denoise/blur.comp", "add_neighbor",
        "weight *= float(center.deviation < 0.1 * luminance(center.radiance)); "
        "correct(sum, center, other, difference, weight, is_filtered);")),
    "what is uncovered: histories of what was there": (check_moving_block, Bug(
        "passes/denoise/previous_frame.glsl", "is_the_same", "return then.kind == guide.kind;")),
})  # fmt: skip
