"""Shapes that turn about an axis, and planes: closed, of the right volume, facing outward."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk import shapes

SOLIDS = {
    "cylinder": (shapes.cylinder(0.5, 3, 256), math.pi * 0.5**2 * 3),
    "cone": (shapes.cone(0.5, 3, 256), math.pi * 0.5**2),
    "capsule": (shapes.capsule(0.5, 3, 256), math.pi * 0.5**2 * (3 + 4 / 3 * 0.5)),
    "torus": (shapes.torus(2, 0.5, 256), 2 * math.pi**2 * 2 * 0.5**2),
}


@pytest.mark.parametrize(("mesh", "volume"), SOLIDS.values(), ids=SOLIDS)
def test_solids(mesh, volume):
    a, b, c = (mesh.positions.astype(np.float64)[mesh.triangles[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)
    assert (np.linalg.norm(facing, axis=1) > 0).all()
    assert np.sum(a * facing) / 6 == pytest.approx(volume, rel=1e-3)
    _, points = np.unique(mesh.positions, axis=0, return_inverse=True)
    edges = points.reshape(-1)[mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1])), "each edge has two triangles"
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)
    for corner in mesh.normals[mesh.triangles].swapaxes(0, 1):
        assert ((corner * facing).sum(axis=1) > 0).all()
    assert (mesh.uvs.min(), mesh.uvs.max()) == (0, 1)


def test_a_plane_faces_up_and_shows_a_picture_upright():
    made = shapes.plane(4, 2)
    assert (made.positions.min(axis=0).tolist(), made.positions.max(axis=0).tolist()) == ([-2, 0, -1], [2, 0, 1])
    a, b, c = made.positions[made.triangles[0]]
    assert np.cross(b - a, c - a)[1] > 0
    np.testing.assert_array_equal(made.uvs, made.positions[:, ::2] / (4, 2) + 0.5)
    assert shapes.plane(3).positions.max() == 1.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.plane(0), "a plane needs a width above 0"),
        (lambda: shapes.cone(height="tall"), "height above 0"),
        (lambda: shapes.torus(1, 1), "tube_radius below its radius"),
        (lambda: shapes.capsule(segments=2), "3 segments"),
        (lambda: shapes.box(0.1), "lowest and its highest corner"),
        (lambda: shapes.box(1, 2, 3), "three numbers each"),
        (lambda: shapes.box((1, 2, 3)), r"not \(1, 2, 3\) and None"),
        (lambda: shapes.capsule(segments=32.0), "not 32.0"),
        (lambda: shapes.torus(segments=5), "6 segments"),
    ],
)
def test_refused_shapes(make, message):
    with pytest.raises(sv.SolariError, match=message):
        make()
