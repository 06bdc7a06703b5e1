"""Pixel filters: the pixels across an edge between light and dark show the filter's cumulative distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp

WIDTH = 12
HEIGHT = 48
SAMPLES = 256


def blackman_harris(x):
    """Nuttall's four terms over [-1.5, 1.5] pixels, not normalized."""
    turn = math.pi * x / 1.5
    return 0.35875 + 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn) + 0.01168 * np.cos(3 * turn)


def share(pixel_filter, distance):
    """The share of a filter to the right of a vertical edge, which is `distance` pixels to the right of its center."""
    if pixel_filter == "box":
        return min(max(0.5 - distance, 0.0), 1.0)
    if pixel_filter == "gaussian":  # radial; the standard deviation is half a pixel, the radius two pixels
        radial = lambda r: r * math.exp(-2 * r * r) * 2 * math.acos(min(max(distance / r, -1), 1))  # noqa: E731
        inside = integrate.quad(radial, 0, 2, points=[min(max(abs(distance), 1e-9), 2)])[0]
        return inside / (2 * math.pi * integrate.quad(lambda r: r * math.exp(-2 * r * r), 0, 2)[0])
    if distance >= 1.5:
        return 0.0
    whole = integrate.quad(blackman_harris, -1.5, 1.5)[0]
    return integrate.quad(blackman_harris, max(distance, -1.5), 1.5)[0] / whole


@pytest.mark.parametrize("pixel_filter", ["box", "gaussian", "blackman_harris"])
def test_an_edge_draws_the_filter(device, pixel_filter):
    """The picture is bright to the right of an edge 0.3 pixels right of its center, and black to the left."""
    edge = 0.3
    pixel = 2 * math.tan(math.radians(15)) / HEIGHT  # a pixel's size at distance 1
    bright = shapes.quad((edge * pixel + 5, 0, -1), (5, 0, 0), (0, 5, 0))
    scene = sv.Scene(sv.Instance(mesh=bright, material=lamp(1.0)))
    camera = sv.Camera(vertical_fov=math.radians(30))
    with sv.PathTracer(device, scene, (WIDTH, HEIGHT), max_bounces=0, pixel_filter=pixel_filter) as tracer:
        columns = tracer.render(camera, samples=SAMPLES)["radiance"][..., 1].mean(axis=0)
    expected = np.array([share(pixel_filter, edge - (x + 0.5 - WIDTH / 2)) for x in range(WIDTH)])
    deviation = np.sqrt(np.maximum(expected * (1 - expected), 1e-6) / (SAMPLES * HEIGHT))
    bound = stats.norm.isf(0.005 / WIDTH / 2)
    assert (np.abs(columns - expected) <= bound * deviation + 1e-6).all(), (columns, expected)
