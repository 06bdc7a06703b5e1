"""Points and lines of glTF files are closed spheres and tubes around them."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.scene.files.gltf import points_and_lines
from solari_vk.scene.files.gltf.points_and_lines import LINE_RADIUS, POINT_RADIUS

SQUARE = [[0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0]]
DIAGONAL = 5.0
SPHERE = 20  # triangles
TUBE = 12
COLORS = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]]


def outward_volume(mesh):
    """The volume that triangles enclose, positive if their fronts are outside."""
    corners = mesh.positions[mesh.triangles].astype(float)
    return np.linalg.det(corners).sum() / 6


def test_points_are_spheres(writer):
    writer.mesh({"POSITION": SQUARE, "COLOR_0": COLORS}, mode=0)
    scene = writer.load(strict=True)
    (instance,) = scene
    mesh, radius = instance.mesh, POINT_RADIUS * DIAGONAL
    assert mesh.triangles.shape == (4 * SPHERE, 3)
    nearest = np.argmin(np.linalg.norm(mesh.positions[:, None] - SQUARE, axis=-1), axis=1)
    np.testing.assert_allclose(mesh.positions - np.take(SQUARE, nearest, axis=0), radius * mesh.normals, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(mesh.colors, np.take(COLORS, nearest, axis=0))
    icosahedron = 2.53615  # the volume in the unit sphere
    assert outward_volume(mesh) == pytest.approx(4 * icosahedron * radius**3, rel=1e-3)
    assert scene.warnings == [
        "points are drawn as spheres with a radius of at most 1/400 of their primitive's size (thinner than a pixel "
        "they break up in realtime frames in motion: render these larger, or by the path tracer): mesh 0, primitive 0"
    ]


@pytest.mark.parametrize(
    ("mode", "lines"), [(1, [(0, 1), (2, 3)]), (2, [(0, 1), (1, 2), (2, 3), (3, 0)]), (3, [(0, 1), (1, 2), (2, 3)])]
)
@pytest.mark.parametrize("indexed", [False, True])
def test_lines_are_tubes_with_round_ends(writer, mode, lines, indexed):
    if indexed:
        writer.mesh({"POSITION": [[9, 9, 9], *SQUARE], "COLOR_0": [[1, 1, 1], *COLORS]}, [1, 2, 3, 4], mode=mode)
    else:
        writer.mesh({"POSITION": SQUARE, "COLOR_0": COLORS}, mode=mode)
    scene = writer.load(strict=True)
    (instance,) = scene
    mesh, radius = instance.mesh, LINE_RADIUS * DIAGONAL
    assert mesh.triangles.shape == (4 * SPHERE + len(lines) * TUBE, 3)
    tubes = mesh.triangles[4 * SPHERE :].reshape(len(lines), TUBE, 3)
    for (start, end), tube in zip(lines, tubes, strict=True):
        a, b = np.array(SQUARE[start], float), np.array(SQUARE[end], float)
        corners = mesh.positions[np.unique(tube)]
        axis = (b - a) / np.linalg.norm(b - a)
        np.testing.assert_allclose(np.linalg.norm(np.cross(corners - a, axis), axis=1), radius, rtol=1e-3)
        assert sorted(np.round((corners - a) @ axis / np.linalg.norm(b - a), 4).tolist()) == [0] * 6 + [1] * 6
        area = np.cross(*(mesh.positions[tube[:, n]] - mesh.positions[tube[:, 0]] for n in (1, 2))) / 2
        middle = mesh.positions[tube].mean(axis=1) - a
        outside = middle - (middle @ axis)[:, None] * axis
        assert ((area * outside).sum(axis=1) > 0).all(), "fronts are outside"
        assert np.linalg.norm(area, axis=1).sum() == pytest.approx(6 * radius * np.linalg.norm(b - a), rel=1e-3)
        np.testing.assert_allclose(mesh.colors[tube[0, 0]], COLORS[start])
    assert scene.warnings == [
        "lines are drawn as tubes with a radius of 1/1000 of their primitive's size (thinner than a pixel "
        "they break up in realtime frames in motion: render these larger, or by the path tracer): mesh 0, primitive 0"
    ]


def test_spheres_follow_skins_and_morph_targets(writer):
    up = writer.accessor([[0, 0, 1]] * 4)
    joints, weights = writer.accessor([[0, 0, 0, 0]] * 3 + [[1, 0, 0, 0]], "u1"), writer.accessor([[1, 0, 0, 0]] * 4)
    attributes = {"POSITION": SQUARE, "NORMAL": [[0, 0, 1]] * 4, "TANGENT": [[1, 0, 0, 1]] * 4}
    target = {"POSITION": up, "NORMAL": up}
    mesh = writer.mesh({**attributes, "JOINTS_0": joints, "WEIGHTS_0": weights}, mode=0, targets=[target])
    nodes = [writer.node(), writer.node(translation=[10, 0, 0])]
    writer.node(mesh=mesh, skin=writer.add("skins", joints=nodes), weights=[1])
    (instance,) = writer.load(strict=True)
    mesh = instance.mesh
    assert (mesh.tangents, mesh.deformation.target_normals) == (None, None), "they are those of the points"
    moved = instance.posed_mesh().positions - instance.mesh.positions
    last = np.linalg.norm(instance.mesh.positions - SQUARE[3], axis=1) < 1
    np.testing.assert_allclose(moved[last], np.tile([10, 0, 1], (last.sum(), 1)), atol=1e-5)
    np.testing.assert_allclose(moved[~last], np.tile([0, 0, 1], ((~last).sum(), 1)), atol=1e-5)


@pytest.mark.parametrize(("count", "mode"), [(1, 0), (2, 3)])
def test_what_is_at_one_place_has_a_radius_of_a_centimeter(writer, count, mode):
    writer.mesh({"POSITION": [[1, 2, 3]] * count}, mode=mode)
    scene = writer.load()
    (instance,) = scene
    lengths = np.linalg.norm(instance.mesh.positions - [1, 2, 3], axis=1)
    np.testing.assert_allclose(lengths, 0.01, rtol=1e-3)
    assert len(instance.mesh.triangles) == count * SPHERE
    assert len(scene.warnings) == 1


def test_lines_without_an_end_are_left_out(writer):
    writer.mesh({"POSITION": [[1, 2, 3]]}, mode=3)
    scene = writer.load()
    assert not scene.instances
    assert scene.warnings[-1].startswith("primitives without any triangle of some area are left out")


def test_many_points_are_smaller_and_thinned_out(writer, monkeypatch):
    monkeypatch.setattr(points_and_lines, "_MOST_POINTS", 50_000)
    grid = np.stack(np.meshgrid(np.arange(400), np.arange(200)), axis=-1).reshape(-1, 2)
    writer.mesh({"POSITION": np.c_[grid, np.zeros(len(grid))]}, mode=0)
    scene = writer.load()
    (instance,) = scene
    assert len(instance.mesh.triangles) == 8 * 40_000
    assert "only one of 2 points or lines is drawn: mesh 0, primitive 0" in scene.warnings
    assert instance.mesh.positions[:, 2].max() == pytest.approx(0.5 / 200 * np.hypot(398, 199), rel=0.01)
