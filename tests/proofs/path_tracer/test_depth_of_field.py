"""Depth of field of a thin lens: a small lamp becomes a disk of the width that optics gives, with the same light."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp

SIZE = (64, 64)
FOV, DISTANCE, APERTURE = 0.5, 4.0, 0.4
CAMERAS = {"perspective": {}, "orthographic": {"orthographic_height": 2 * DISTANCE * math.tan(FOV / 2)}}


def spread(device, focus, aperture=APERTURE, **fields):
    """The light of a picture of a small lamp, and its variance along x and y in squared pixels."""
    side = 0.06
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, -DISTANCE), (side, 0, 0), (0, side, 0)), lamp(1000.0, "lamp")))
    camera = sv.Camera(vertical_fov=FOV, aperture=aperture, focus_distance=focus, **fields)
    with sv.PathTracer(device, scene, SIZE, seed=8, max_bounces=0) as tracer:
        light = tracer.render(camera, samples=1024)["radiance"].sum(axis=2).astype(np.float64)
    total = light.sum()
    variances = []
    for axis in range(2):
        along = light.sum(axis=axis) / total
        at = np.arange(len(along))
        variances.append((along * (at - (along * at).sum()) ** 2).sum())
    return total, np.array(variances)


def check(device, kind, focus):
    sharp, blurred = (spread(device, focus, aperture, **CAMERAS[kind]) for aperture in (0.0, APERTURE))
    assert blurred[0] == pytest.approx(sharp[0], rel=0.05)
    # The disk's radius in meters at the lamp; the variance of a disk along an axis is a quarter of its squared radius.
    radius = APERTURE / 2 * abs(1 - DISTANCE / focus)
    pixel = 2 * DISTANCE * math.tan(FOV / 2) / SIZE[1]
    np.testing.assert_allclose(blurred[1] - sharp[1], (radius / pixel) ** 2 / 4, rtol=0.06, atol=0.1)


@pytest.mark.parametrize("focus", [2.0, 4.0, 12.0])
@pytest.mark.parametrize("kind", CAMERAS)
def test_the_disk_of_confusion(device, kind, focus):
    check(device, kind, focus)


@pytest.mark.slow
def test_a_lens_twice_as_wide_is_noticed(device):
    with seeded(Bug("scene/camera.glsl", "through_lens", "return correct(ray, 2.0 * on_lens);")), \
            pytest.raises(AssertionError):
        check(device, "perspective", 2.0)


def lit_with_and_without_lens(device):
    """The pixels that lamps light, which all are in focus, also at the picture's edge."""
    scene = sv.Scene()
    for x in (-2.8, 0.0, 2.8):
        scene.add(shapes.quad((x, 0, -DISTANCE), (0.1, 0, 0), (0, 0.1, 0)), lamp(1000.0, "lamp"))
    lit = []
    for aperture in (0.0, 2.0):
        camera = sv.Camera(vertical_fov=1.4, aperture=aperture, focus_distance=DISTANCE)
        with sv.PathTracer(device, scene, SIZE, seed=8, max_bounces=0) as tracer:
            lit.append(tracer.render(camera, samples=64)["radiance"].max(axis=2) > 0)
    return lit


def test_what_is_in_focus_is_sharp_everywhere(device):
    np.testing.assert_array_equal(*lit_with_and_without_lens(device))
    sphere = Bug("scene/camera.glsl", "through_lens", "ray.depth_per_t = 1.0; return correct(ray, on_lens);")
    with seeded(sphere):
        sharp, blurred = lit_with_and_without_lens(device)
    assert (sharp != blurred).any(), "a focus at equal distances instead of depths is seen"


def test_the_realtime_renderer_refuses_it(device):
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, (8, 8)) as renderer, pytest.raises(sv.SolariError, match="only PathTracer renders"):
        renderer.render(sv.Camera(aperture=0.1))


def test_a_changed_lens_starts_a_new_picture(device):
    scene, camera = sv.builtin("cornell_box"), sv.Camera.look_at((1, 1, -3), (1, 1, 1))
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        for fields in ({"aperture": 0.2}, {"focus_distance": 2.0}, {"orthographic_height": 2.0}):
            before = tracer.render(camera, samples=2)["radiance"].copy()
            camera.update(**fields)
            assert (tracer.render(camera, samples=2)["radiance"] != before).any()
