"""There is no limit of 65,536, neither for lights nor for the triangles of a light."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def triangle_grid(side):
    """A square of 2 side^2 triangles over [-1, 1]^2 at height 1, facing down."""
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    corners = np.stack([first, first + 1, first + side + 1, first + 1, first + side + 2, first + side + 1], axis=1)
    positions = np.stack([x, np.ones_like(x), z], axis=-1).reshape(-1, 3)
    return sv.Mesh(positions=positions, indices=corners.reshape(-1, 3))


def floor_under(*lamps):
    floor = shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0))
    scene = sv.Scene(sv.Instance(mesh=floor, material=matte(0.5)), *lamps)
    scene.add(sv.Camera.look_at((0, 0.9, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=math.radians(60)))
    return scene


def render(device, scene):
    """The mean radiance of the floor, rendered with light samples only, and its standard error."""
    with sv.PathTracer(device, scene, (32, 32), max_bounces=1, lambert=True, light_strategy="nee") as tracer:
        radiance = tracer.render(samples=64)["radiance"]
        return float(radiance[..., 1].mean()), math.sqrt(tracer["variance"].mean() / radiance[..., 0].size)


@pytest.fixture(scope="module")
def expected(device):
    """The floor's radiance under a square light of only two triangles."""
    return render(device, floor_under(sv.Instance(mesh=triangle_grid(1), material=lamp(3.0))))


def test_a_light_of_many_triangles(device, expected):
    mesh = triangle_grid(300)
    assert len(mesh.triangles) > 2 * 65_536
    value, error = render(device, floor_under(sv.Instance(mesh=mesh, material=lamp(3.0))))
    assert abs(value - expected[0]) < 4 * math.hypot(error, expected[1])
    assert math.hypot(error, expected[1]) < 0.005 * value


def test_a_bright_spot_of_a_dark_lamp(device):
    """A lamp of 20,000 triangles of which 1 % is lit: light samples that took all triangles equally often would have a
    relative variance of 99, those that take the dark part for a tenth of the light have one of 0.1."""
    mesh = triangle_grid(100)
    pixels = np.zeros((10, 10, 3), np.uint8)
    pixels[2, 6] = 255
    texture = sv.Texture(sv.TextureImage(pixels), magnification="nearest")
    material = lamp(300.0)
    material.emissive_texture = texture
    whole = sv.Instance(sv.Mesh(mesh.positions, mesh.triangles, uvs=0.5 + 0.5 * mesh.positions[:, ::2]), material)
    spot = sv.Instance(shapes.quad((0.3, 1, -0.5), (0.1, 0, 0), (0, 0, 0.1)), lamp(300.0))
    (value, error), (truth, least) = (render(device, floor_under(item)) for item in (whole, spot))
    assert abs(value - truth) < 4 * math.hypot(error, least)
    assert 32 * 32 * 64 * (error / value) ** 2 < 0.2


def test_many_lights(device, expected):
    """Seventy thousand instances, each a light, tile the same square. A limit on indices would lose the last ones."""
    side = 265
    half = 1 / side
    mesh, material = shapes.quad((0, 0, 0), (half, 0, 0), (0, 0, half)), lamp(3.0)
    assert side * side > 65_536
    lamps = []
    for x in np.linspace(-1 + half, 1 - half, side):
        for z in np.linspace(-1 + half, 1 - half, side):
            lamps.append(sv.Instance(mesh=mesh, material=material, transform=place(at=(x, 1.0, z))))
    value, error = render(device, floor_under(*lamps))
    assert abs(value - expected[0]) < 4 * math.hypot(error, expected[1])
