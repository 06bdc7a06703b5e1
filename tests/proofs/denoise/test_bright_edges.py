"""Edges of what is far brighter than its surroundings: reflections of lamps, lamps in motion, blended surfaces."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from support.frames import make_renderer, path_traced, replicate
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.output.compare import true_relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place
from solari_vk.scene.matrices import rotation, turned_about

SIZE = (48, 48)
BLACK = (0.0, 0.0, 0.0)
WALL, LAMP = 0.05, 10.0  # radiance of a lamp in motion
LAMP_SIZE = (32, 24)
LAMP_SPEED = 0.37  # pixels a frame


def scene_under_lamp(at, radiance):
    """A dim sky and a square lamp, 0.7 m wide."""
    scene = sv.Scene()
    scene.add(shapes.facing_quad(at, 0.35), sv.Material(base_color=BLACK, emissive=(radiance,) * 3), name="lamp")
    scene.environment = sv.Environment(np.full((8, 16, 3), 0.02))
    return scene


def ball():
    """A smooth ball of metal, which mirrors the lamp in a dim room."""
    scene = scene_under_lamp((1.5, 1.5, 2.0), 40.0)
    scene.add(shapes.sphere(0.45, 48), sv.Material(metallic=1.0, base_color=(0.9, 0.6, 0.3), roughness=0.14))
    return scene, [sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.4)] * 8


def beads():
    """Balls a few pixels wide, which mirror the lamp in one of their pixels, while the camera turns."""
    scene = scene_under_lamp((2.5, 1.5, 3.0), 120.0)
    bead, metal = shapes.sphere(0.09, 24), sv.Material(metallic=1.0, base_color=(0.5, 0.5, 0.5), roughness=0.34)
    for x in range(-4, 5):
        for y in range(-3, 4):
            scene.add(bead, metal, (0.2 * x, 0.25 * y, 0))
    start = sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.5).transform
    turns = [rotation((0, 1, 0), -1.3 * frame * 0.5 / SIZE[1]) for frame in range(-23, 1)]
    return scene, [sv.Camera(transform=turned_about(start[:3, 3], turn, start), vertical_fov=0.5) for turn in turns]


def pane(step, frames):
    """A dark pane that covers half, before a bright wall. step: meters that the camera moves in a frame."""
    scene = scene_under_lamp((1.5, 1.5, 3.0), 40.0)
    dark = sv.Material(base_color=(0.05, 0.05, 0.05), alpha=0.5, alpha_mode="blend", roughness=1.0)
    scene.add(shapes.quad((0, 0, 0), (1.2, 0, 0), (0, 1.2, 0)), dark)
    scene.add(shapes.quad((0, 0, -0.5), (4, 0, 0), (0, 4, 0)), sv.Material(base_color=0.42, roughness=1.0))
    places = [step * frame for frame in range(1 - frames, 1)]
    return scene, [sv.Camera.look_at((x, 0, 2.5), (x, 0, 0), vertical_fov=0.5) for x in places]


# The scene with its cameras, the number of seeds, and the bar for their mean relMSE.
CASES = {
    "light of a mirrored lamp stays there": (ball, (), 6, 0.05),
    "reflections of curved surfaces in motion": (beads, (), 8, 0.55),
    "blended surfaces in the second frame": (pane, (0.0, 2), 4, 0.012),
    "blended surfaces in motion": (pane, (0.01, 12), 4, 0.004),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_error_is_small(case, device):
    make, arguments, seeds, bar = CASES[case]
    scene, cameras = make(*arguments)

    def observe():
        for camera in cameras:
            frame = renderer.render(camera)
        return true_relative_mse(np.asarray(frame["radiance"], np.float64), *references)

    samples = 256 if make is pane else 512
    references = [path_traced(device, scene, samples, SIZE, cameras[-1], seed=seed) for seed in (1, 2)]
    with make_renderer(device, scene, SIZE, denoise=True, antialiasing=True) as renderer:
        errors = replicate(renderer, seeds, observe)
    print(case, np.round(errors, 4), errors.mean())
    assert errors.mean() < bar


@pytest.mark.slow
def test_a_lamp_in_motion(device):
    """The relMSE of a row of pixels across a lamp before a wall that glows, against their exact means: pixels next to
    its edges don't flash when their sample happens to show it."""
    width, height = LAMP_SIZE
    scene = sv.Scene()
    for z, radiance, halves in ((-0.01, WALL, (8, 8)), (0.0, LAMP, (0.5, 0.4))):
        mesh = shapes.quad((0, 0, z), (halves[0], 0, 0), (0, halves[1], 0))
        lamp = scene.add(mesh, sv.Material(base_color=BLACK, emissive=(radiance,) * 3))
    camera = sv.Camera.look_at((0, 0, 4), (0, 0, 0), vertical_fov=0.6)
    pixel = 2 * math.tan(0.3) * 4 / height
    left = np.arange(width)
    errors = []
    with make_renderer(device, scene, LAMP_SIZE, denoise=True, antialiasing=True) as renderer:
        for renderer.seed in range(8):
            renderer.reset()
            for frame in range(-20, 20):
                x = frame * LAMP_SPEED * pixel
                lamp.transform = place(at=(x, 0, 0))
                row = np.asarray(renderer.render(camera)["radiance"], np.float64)[height // 2, :, 0]
                begin, end = width / 2 + (x + np.array([-0.5, 0.5])) / pixel
                covered = np.clip(np.minimum(left + 1, end) - np.maximum(left, begin), 0, 1)
                truth = WALL + covered * (LAMP - WALL)
                if frame >= -12:
                    errors.append(np.mean((row - truth) ** 2 / (truth**2 + 0.01)))
    print(np.mean(errors), np.max(errors))
    assert np.mean(errors) < 0.3


SAMPLES = "passes/taa/samples.glsl"
BUGS = {
    "light of a mirrored lamp stays there": Bug("passes/denoise/variance.comp", "add_bounds", ""),
    "reflections of curved surfaces in motion": Bug("passes/denoise/constants.glsl", "LOBE_NORMAL_TOLERANCE", "1e9"),
    "blended surfaces in motion": Bug(
        "passes/taa/history.glsl", "is_blended", "return is_still(center) && correct(center);"
    ),
}
test_a_seeded_bug_is_noticed = bug_tests(
    {
        **{case: (functools.partial(test_error_is_small, case), bug) for case, bug in BUGS.items()},
        "a lamp in motion: bright samples count whole": (
            test_a_lamp_in_motion,
            Bug(SAMPLES, "tone_weight", "return 1.0;"),
        ),
    }
)
