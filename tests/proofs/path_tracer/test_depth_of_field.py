"""Depth of field of a thin lens: a small lamp becomes a disk of the width that optics gives, with the same light."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.frames import path_traced
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp

SIZE = (64, 64)
FOV = 0.5
DISTANCE = 4.0
APERTURE = 0.4
CAMERAS = {"perspective": {}, "orthographic": {"orthographic_height": 2 * DISTANCE * math.tan(FOV / 2)}}


def spread_of(light):
    """Of light (64, 64), all of it, and its variance along x and y in squared pixels."""
    at, variances = np.arange(SIZE[0]), []
    for axis in range(2):
        along = light.sum(axis=axis) / light.sum()
        variances.append((along * (at - (along * at).sum()) ** 2).sum())
    return light.sum(), np.array(variances)


def check_disk(sharp, blurred, focus):
    """Requires that a lens spreads the lamp's light as optics says: the variance of a disk along an axis is a quarter
    of its squared radius."""
    assert blurred[0] == pytest.approx(sharp[0], rel=0.05)
    radius = APERTURE / 2 * abs(1 - DISTANCE / focus)  # in meters at the lamp
    pixel = 2 * DISTANCE * math.tan(FOV / 2) / SIZE[1]
    np.testing.assert_allclose(blurred[1] - sharp[1], (radius / pixel) ** 2 / 4, rtol=0.06, atol=0.1)


def spread(device, **fields):
    """`spread_of` a picture of a small lamp."""
    scene = sv.Scene(sv.Camera(vertical_fov=FOV, **fields))
    scene.add(shapes.quad((0, 0, -DISTANCE), (0.06, 0, 0), (0, 0.06, 0)), lamp(1000.0))
    return spread_of(path_traced(device, scene, 1024, SIZE, seed=8, max_bounces=0).sum(axis=2))


@pytest.mark.parametrize(("kind", "focus"), [("perspective", 2.0), ("perspective", 12.0), ("orthographic", 2.0)])
def test_the_disk_of_confusion(device, kind, focus):
    check_disk(*(spread(device, aperture=a, focus_distance=focus, **CAMERAS[kind]) for a in (0.0, APERTURE)), focus)


def test_what_is_in_focus_is_sharp_everywhere(device):
    """The same pixels are lit with and without a lens, also at the picture's edge."""
    lit = []
    for aperture in (0.0, 2.0):
        scene = sv.Scene(sv.Camera(vertical_fov=1.4, aperture=aperture, focus_distance=DISTANCE))
        for x in (-2.8, 0.0, 2.8):
            scene.add(shapes.quad((x, 0, -DISTANCE), (0.1, 0, 0), (0, 0.1, 0)), lamp(1000.0))
        lit.append(path_traced(device, scene, 64, SIZE, seed=8, max_bounces=0).max(axis=2) > 0)
    np.testing.assert_array_equal(*lit)


def test_an_aperture_of_blades(device):
    """The lamp's image has the variance of a regular polygon with the circumradius R: R² (2 + cos(2 pi / n)) / 12."""
    for blades in (3, 6):
        sharp, blurred = (spread(device, aperture=a, focus_distance=2.0, aperture_blades=blades) for a in (0, APERTURE))
        pixel = 2 * DISTANCE * math.tan(FOV / 2) / SIZE[1]
        radius = APERTURE / 2 / pixel
        expected = radius**2 / 12 * (2 + math.cos(2 * math.pi / blades))
        np.testing.assert_allclose(blurred[1] - sharp[1], expected, rtol=0.08)


def test_blades_are_turned(device):
    """A triangle with a corner at the right, or at the left."""
    for turn, right in ((0.0, True), (math.pi, False)):
        scene = sv.Scene(
            sv.Camera(
                vertical_fov=FOV, aperture=APERTURE, focus_distance=2.0, aperture_blades=3, aperture_rotation=turn
            )
        )
        scene.add(shapes.quad((0, 0, -DISTANCE), (0.06, 0, 0), (0, 0.06, 0)), lamp(1000.0))
        light = path_traced(device, scene, 256, SIZE, seed=8, max_bounces=0)[..., 0].sum(axis=0)
        along, at = light / light.sum(), np.arange(SIZE[0]) - (SIZE[0] - 1) / 2
        radius = APERTURE / 2 / (2 * DISTANCE * math.tan(FOV / 2) / SIZE[1])
        # The third moment of an equilateral triangle of the circumradius R about its center is R^3 / 40.
        assert along @ at**3 == pytest.approx((1 if right else -1) * radius**3 / 40, rel=0.15)


@pytest.mark.parametrize(
    "fields",
    [
        {"projection": "fisheye", "vertical_fov": 2.0},
        {"projection": "equirectangular"},
        {"vertical_fov": FOV, "distortion": (-0.1, 0.01, 0, 0)},
    ],
    ids=["fisheye", "panorama", "distorted"],
)
def test_other_lenses_have_apertures_too(device, fields):
    """A disk of confusion of the angle that the aperture has from the lamp, less that from the focus."""
    size = (192, 96)
    widths = []
    for aperture, focus in ((0.0, 1.0), (2 * APERTURE, DISTANCE), (2 * APERTURE, 2.0)):
        camera = sv.Camera(**fields, aperture=aperture, focus_distance=focus)
        scene = sv.Scene(camera)
        scene.add(shapes.quad((0, 0, -DISTANCE), (0.06, 0, 0), (0, 0.06, 0)), lamp(1000.0))
        light = path_traced(device, scene, 256, size, seed=8, max_bounces=0).sum(axis=(0, 2))
        along, at = light / light.sum(), np.arange(size[0])
        widths.append((along * (at - (along * at).sum()) ** 2).sum())
    edge = camera.project((APERTURE * abs(1 - DISTANCE / 2.0), 0, -DISTANCE), size)[0] - (size[0] - 1) / 2
    assert widths[1] == pytest.approx(widths[0], abs=0.15)
    assert widths[2] - widths[0] == pytest.approx(edge**2 / 4, rel=0.1)


def test_focus_on_an_instance(device):
    ball = sv.Instance(shapes.sphere(0.3, 8), transform=(1, 0, -4))
    assert sv.Camera().focus_on(ball, 2.0).focus_distance == pytest.approx(4, abs=0.02)
    fisheye = sv.Camera(projection="fisheye", vertical_fov=2.0).focus_on(ball, 2.0)
    assert fisheye.focus_distance == pytest.approx(math.hypot(4, 1), abs=0.02)
    assert fisheye.aperture == pytest.approx(0.024 / 2 / 1.0 / 2.0)


def test_a_changed_lens_starts_a_new_picture(device):
    scene, camera = sv.builtin("cornell_box"), sv.Camera.look_at((1, 1, -3), (1, 1, 1))
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        for fields in ({"aperture": 0.2}, {"focus_distance": 2.0}, {"orthographic_height": 2.0}):
            before = tracer.render(camera, samples=2)["radiance"].copy()
            camera.update(**fields)
            assert (tracer.render(camera, samples=2)["radiance"] != before).any()


LENS = ("scene/camera.glsl", "through_lens")
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a lens twice as wide": (
            lambda device: test_the_disk_of_confusion(device, "perspective", 2.0),
            Bug(*LENS, "return correct(ray, 2.0 * on_lens);"),
        ),
        "a focus at equal distances instead of depths": (
            test_what_is_in_focus_is_sharp_everywhere,
            Bug(*LENS, "ray.depth_per_t = 1.0; return correct(ray, on_lens);"),
        ),
    }
)
