"""Pixels that have come into view in the latest frames, beside those whose histories are long."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import frames_in_history, make_renderer, path_traced, path_tracer_at_centers, replicate
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene.builtin import builtin, place

SIZE = (96, 96)
FRAMES, SEEDS = 20, 2
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
    scene.instances["short block"].transform = place(at=(0.04 * (step - FRAMES / 2), 0.15, 0.0))
    return scene.camera


def watch(device, name, move):
    """What the last frame shows, for all seeds: squared relative errors and the lengths of histories; and for the last
    four frames, whether pixels show the object that moves."""
    scene, shown = builtin(name), []
    for material in scene.materials:
        material.double_sided = False  # the camera leaves mirror_hall, and looks in through a mirror's back

    def observe():
        for step in range(FRAMES):
            frame = renderer.render(move(scene, step))
            shown.append(frame.mask("short block") if name == "cornell_box" else None)
        return frame["radiance"].astype(np.float64), np.repeat(frames_in_history(frame)[..., None], 3, axis=-1)

    with make_renderer(device, scene, SIZE, denoise=True, jitter=False) as renderer:
        found = replicate(renderer, SEEDS, observe)
    pictures, lengths = found[:, 0], found[:, 1, ..., 0]
    with path_tracer_at_centers():
        truth = path_traced(device, scene, 256, SIZE, move(scene, FRAMES - 1), seed=99)
    squares = (pictures - truth) ** 2 / (truth**2 + 1e-2 * truth.mean() ** 2)
    return squares.mean(axis=-1), lengths, np.array(shown[-4:])


def check_new_pixels(errors, lengths, new):
    """Require that the error of new pixels is not far above that of settled ones."""
    settled = (lengths >= SETTLED) & ~new
    young, old = errors[new].mean(), errors[settled].mean()
    print(f"{new.sum()} new pixels, {young:.4f}; settled {old:.4f}: {young / old:.2f}")
    assert new.sum() > 50
    assert young / old < BAR


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cornell_box", "sphere_grid", "mirror_hall"])
def test_what_comes_into_view(device, name):
    """Pixels at the border, and beside objects that the camera passes."""
    errors, lengths, _ = watch(device, name, strafe)
    check_new_pixels(errors, lengths, (lengths > 0) & (lengths <= YOUNG))


@pytest.mark.slow
def test_what_a_moving_block_uncovers(device):
    """Pixels that showed the block one to three frames ago."""
    errors, lengths, block = watch(device, "cornell_box", slide)
    check_new_pixels(errors, lengths, np.broadcast_to(block[:-1].any(axis=0) & ~block[-1], errors.shape))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "what comes into view: it counts as certain": (
            lambda device: test_what_comes_into_view(device, "cornell_box"),
            Bug(
                "passes/denoise/variance.comp",
                "estimate_signal",
                "Signal found = correct(lobe, sum, trimmed_mean_luminance); "
                "if (lobe.frames < 4.0) { found.standard_error *= 0.01; } return found;",
            ),
        ),
        "what is uncovered: histories of what was there": (
            test_what_a_moving_block_uncovers,
            Bug("passes/denoise/previous_frame.glsl", "is_consistent", "return previous_guide.kind == guide.kind;"),
        ),
    }
)
