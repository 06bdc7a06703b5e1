"""Structured light against the formulas of its papers, and the projector's shadow against geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes

SIZE = (64, 48)
EXACT = sv.StructuredLightCamera(disparity_step=0.0)


def wall(distance, angle=0.0):
    """A wall across -z, turned about the vertical axis."""
    half = (50 * math.cos(angle), 0, 50 * math.sin(angle))
    return sv.Instance(shapes.quad((0, 0, -distance), half, (0, 50, 0)), sv.Material(double_sided=True))


def capture(device, scene, sensor, camera=None, size=SIZE, **options):
    with sv.RayTracer(device, scene) as tracer:
        found = sensor.capture(tracer, camera or sv.Camera(vertical_fov=0.8), size, **options)
    # Of a sensor without noise in front of a wall both are known in the middle; rays to other pixels are longer.
    assert (found.amplitude, found.depth.shape) == (None, (size[1], size[0]))
    assert not (found.distance < found.depth * (1 - 1e-6)).any()
    np.testing.assert_array_equal(np.asarray(found), found.depth)
    return found.depth


def test_depths_and_ranges(device):
    for distance, there in ((0.3, False), (2.0, True), (5.5, False)):
        found = capture(device, sv.Scene(wall(distance)), EXACT, noise=False)
        assert np.isfinite(found).all() == np.isfinite(found).any() == there
        if there:
            np.testing.assert_allclose(found, distance, rtol=1e-5)
    steep = capture(device, sv.Scene(wall(2.0, math.radians(83))), EXACT, sv.Camera(vertical_fov=0.05), noise=False)
    assert np.isnan(steep).all()


def test_depths_are_those_of_whole_steps_of_disparity(device):
    camera = sv.Camera(vertical_fov=0.8)
    found = capture(device, sv.Scene(wall(3.0, 0.8)), sv.StructuredLightCamera(), camera, (160, 120), noise=False)
    product = camera.intrinsics((160, 120))[0, 0] * 0.075
    steps = product / found[np.isfinite(found)] * 8
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert len(np.unique(np.round(steps))) > 5


@pytest.mark.parametrize(("distance", "angle"), [(1.0, 0.0), (3.0, 0.0), (2.0, 1.2)])
def test_the_noise_of_depths(device, distance, angle):
    """A narrow view, so that displaced pixels have nearly the same depth."""
    camera, size = sv.Camera(vertical_fov=1e-3), (96, 96)
    found = capture(device, sv.Scene(wall(distance, angle)), EXACT, camera, size, seed=2)
    turned = (angle / (math.pi / 2 - angle)) ** 2
    expected = 0.0012 + 0.0019 * (distance - 0.4) ** 2 + 1e-4 / math.sqrt(distance) * turned
    assert np.std(found) == pytest.approx(expected, rel=0.05)
    again = capture(device, sv.Scene(wall(distance, angle)), EXACT, camera, size, seed=2)
    np.testing.assert_array_equal(found, again)


def test_noise_moves_edges(device):
    """At the edge of a near wall pixels show one wall or the other, off by 0.8 pixels."""
    near = sv.Instance(shapes.quad((-5, 0, -1), (5, 0, 0), (0, 5, 0)), sv.Material(double_sided=True))
    sensor = sv.StructuredLightCamera(disparity_step=0.0, baseline=1e-6)
    found = capture(device, sv.Scene(near, wall(2.0)), sensor, size=(64, 2048), seed=1)
    share = (found > 1.5).mean(axis=0)
    expected = [0.5 * math.erfc(-(column - 31.5) / 0.8 / math.sqrt(2)) for column in range(64)]
    np.testing.assert_allclose(share, expected, atol=0.05)


def test_the_projectors_shadow(device):
    """Left of a bar the wall behind it is missing, as wide as the baseline times the ratio of the gap to the bar's
    distance."""
    bar = sv.Instance(shapes.box((-0.1, -2, -1.001), (0.1, 2, -1)))
    camera = sv.Camera(vertical_fov=0.8)
    size = (320, 240)
    found = capture(device, sv.Scene(bar, wall(2.0)), EXACT, camera, size, noise=False)[120]
    missing = np.flatnonzero(np.isnan(found))
    points = camera.unproject(np.stack([missing, np.full(len(missing), 120)], -1), np.full(len(missing), 2.0), size)
    pixel = 2 * math.tan(0.4) * 2 / 240
    assert points[:, 0].min() == pytest.approx(-0.2 - 0.075, abs=2 * pixel)
    assert points[:, 0].max() == pytest.approx(-0.2, abs=2 * pixel)


@pytest.mark.filterwarnings("error")
def test_a_level_camera_sees_the_floor(device):
    """The angle is that between the normal and the ray: the floor is across the view axis, and rays reach it."""
    floor = sv.Instance(shapes.quad((0, -1, 0), (0, 0, 900), (900, 0, 0)), sv.Material(double_sided=True))
    x, below = np.meshgrid((np.arange(64) - 31.5) * math.tan(0.6) / 24, (np.arange(48) - 23.5) * math.tan(0.6) / 24)
    cosine = below / np.sqrt(1 + x**2 + below**2)
    for max_angle, share in ((math.radians(80), 0.3), (math.pi / 2, 0.5)):
        sensor = sv.StructuredLightCamera(disparity_step=0.0, max_angle=max_angle, max_range=1e3)
        found = capture(device, sv.Scene(floor), sensor, sv.Camera(vertical_fov=1.2), noise=False)
        seen = cosine > math.cos(max_angle) + 1e-9
        np.testing.assert_array_equal(np.isfinite(found), seen)
        assert seen.mean() >= share
        np.testing.assert_allclose(found[seen], 1 / below[seen], rtol=1e-3)
        noisy = capture(device, sv.Scene(floor), sensor, sv.Camera(vertical_fov=1.2), seed=1)
        assert np.isfinite(noisy[36:]).all()


def test_wrong_cameras(device):
    with pytest.raises(SolariError, match="a perspective camera is needed"):
        capture(device, sv.Scene(), EXACT, sv.Camera(projection="fisheye"))
    with pytest.raises(SolariError, match="baseline is a number between"):
        sv.StructuredLightCamera(baseline=0)
    with pytest.raises(SolariError, match="capture: seed must be a whole number from 0 on, not -1"):
        capture(device, sv.Scene(), EXACT, seed=-1)
    assert np.isnan(capture(device, sv.Scene(), EXACT)).all()
