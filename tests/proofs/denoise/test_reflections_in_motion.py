"""Reflections in dielectrics and slightly rough metals while the camera moves: they move by their hit distances."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import make_renderer, path_traced
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.output import oidn
from solari_vk.output.compare import relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place

SIZE = (64, 64)
FRAMES, SPEED = 32, 0.7  # pixels a frame by which the reflection moves
BAR = 0.7  # error over that of Open Image Denoise of the same single frame


def hall(material):
    """A wall that reflects a lit card before a darker wall behind the camera."""
    card, behind = (sv.Material(base_color=(0, 0, 0), emissive=(light,) * 3) for light in (1.0, 0.1))
    return sv.Scene(
        sv.Instance(shapes.quad((0, 0, 0), (3, 0, 0), (0, 3, 0)), material),
        sv.Instance(shapes.quad((0.6, 0, 3.0), (-0.6, 0, 0), (0, 3, 0)), card),
        sv.Instance(shapes.quad((0, 0, 3.2), (-6, 0, 0), (0, 6, 0)), behind),
    )


def open_hall(material):
    """A wall that reflects stripes at infinity."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (3, 0, 0), (0, 3, 0)), material))
    stripes = np.full((64, 128, 3), 0.1)
    stripes[:, np.arange(128) % 8 < 4] = 1.0
    scene.environment = sv.Environment(stripes)
    return scene


@pytest.mark.parametrize(
    ("metallic", "roughness", "make"),
    [
        (0.0, 0.1, hall),
        (0.0, 0.0, hall),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (1.0, 0.2, hall),
                (0.0, 0.3, hall),
                (1.0, 0.1, hall),
                (0.0, 0.1, open_hall),
                (1.0, 0.2, open_hall),
            )
        ),
    ],
)
def test_reflections_follow(device, metallic, roughness, make):
    scene = make(sv.Material(base_color=(metallic,) * 3, metallic=metallic, perceptual_roughness=roughness))
    step = SPEED * 2 * np.tan(0.3) * 5 / SIZE[0]  # meters, for what is 5 m away by way of the wall
    with make_renderer(device, scene, SIZE, denoise=True, antialiasing=True) as renderer:
        for index in range(FRAMES):
            camera = sv.Camera(transform=place(at=(index * step, 0, 2)), vertical_fov=0.6)
            frame = renderer.render(camera)
        picture, raw = (np.asarray(frame[name], np.float64)[..., :3] for name in ("radiance", "raw_radiance"))
    truth = path_traced(device, scene, 512, SIZE, camera, seed=9)
    flat = np.full((*raw.shape[:2], 3), (0.0, 0.0, 1.0))
    denoised = oidn.denoise(raw, np.full_like(flat, 0.5), flat)
    errors = [relative_mse(found[16:48], truth[16:48]) for found in (picture, denoised)]
    print(f"metallic {metallic}, roughness {roughness}: {errors[0]:.4f}, OIDN {errors[1]:.4f}")
    assert errors[0] / errors[1] < BAR


CONSTANTS = "passes/denoise/constants.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "they move like their surface": (
            lambda device: test_reflections_follow(device, 0.0, 0.1, hall),
            Bug(CONSTANTS, "SURFACE_MOTION_ROUGHNESS", "0.0"),
        ),
        "the picture moves like the surface": (
            lambda device: test_reflections_follow(device, 0.0, 0.0, hall),
            Bug("passes/denoise/reflection_motion.comp", "reflects_most", "return false;"),
        ),
        "infinity counts as unknown": (
            lambda device: test_reflections_follow(device, 0.0, 0.1, open_hall),
            Bug(CONSTANTS, "MIN_INVERSE_HIT_DISTANCE", "0.0"),
        ),
    }
)
