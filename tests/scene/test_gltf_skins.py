"""Skins and morph targets of glTF files: their arrays, their animations, and bad files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.gltf_writer import TRIANGLE

import solari_vk as sv
from solari_vk.errors import SolariError

HALF = math.sqrt(0.5)


def skinned(writer, weights=((0.75, 0.25, 0, 0),) * 3, joints=((0, 1, 0, 0),) * 3, **mesh):
    """A triangle on two joints, of which the second is a child of the first; returns the joints' nodes."""
    attributes = {"JOINTS_0": writer.accessor(joints, "u1"), "WEIGHTS_0": writer.accessor(weights)}
    number = writer.mesh(attributes, **mesh)
    upper = writer.node(translation=[0, 1, 0])
    lower = writer.node(children=[upper])
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 3, 1] = -1  # columns are rows in the file
    skin = writer.add("skins", joints=[lower, upper], inverseBindMatrices=writer.accessor(bind.reshape(2, 16)))
    writer.node(mesh=number, skin=skin)
    return lower, upper


def animate(writer, node, path, times, values):
    """Add a clip of one linear channel."""
    sampler = {"input": writer.accessor(times), "output": writer.accessor(values)}
    writer.add("animations", samplers=[sampler], channels=[{"sampler": 0, "target": {"node": node, "path": path}}])


def test_joints_follow_their_nodes(writer):
    lower, upper = skinned(writer)
    animate(writer, upper, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]])
    animate(writer, lower, "translation", [0, 1], [[0, 0, 0], [8, 0, 0]])
    scene = writer.load()
    (instance,) = scene
    assert instance.mesh.deformation.joints.shape == (3, 2), "weights that are 0 everywhere are left out"
    np.testing.assert_allclose(instance.posed_mesh().positions, TRIANGLE, atol=1e-7)
    scene.animate(1, 0, loop=False)
    up = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ (np.transpose(TRIANGLE) - [[0], [1], [0]]) + [[0], [1], [0]]
    np.testing.assert_allclose(instance.posed_mesh().positions, 0.75 * np.array(TRIANGLE) + 0.25 * up.T, atol=1e-6)
    scene.animate(1, 1, loop=False)
    np.testing.assert_allclose(instance.posed_mesh().positions, np.add(TRIANGLE, [8, 0, 0]), atol=1e-6)
    before = instance.joint_matrices
    scene.animate(1, 1, loop=False)
    assert instance.joint_matrices is before, "the same pose costs nothing on the device"
    assert not scene.warnings


def test_weights_of_morph_targets_are_animated(writer):
    up, out = (writer.accessor([direction] * 3) for direction in ([0, 1, 0], [0, 0, 1]))
    mesh = writer.mesh(targets=[{"POSITION": up}, {"POSITION": out}])
    writer.json["meshes"][mesh]["weights"] = [0.5, 0]
    node = writer.node(mesh=mesh)
    still = writer.node(mesh=mesh)
    animate(writer, node, "weights", [0, 1], [[0], [0], [2], [4]])
    scene = writer.load()
    moved, other = scene
    assert still == node + 1
    assert moved.mesh is other.mesh
    np.testing.assert_allclose(moved.posed_mesh().positions, np.add(TRIANGLE, [0, 0.5, 0]))
    scene.animate(0.5)
    np.testing.assert_allclose(moved.posed_mesh().positions, np.add(TRIANGLE, [0, 1, 2]))
    np.testing.assert_allclose(other.posed_mesh().positions, np.add(TRIANGLE, [0, 0.5, 0]))
    scene.animations.add(sv.Animation(scene.animations[0].rig, [], "rest"))
    scene.mix_clips((0, 0.5, 1), ("rest", 0, 3))
    np.testing.assert_allclose(moved.posed_mesh().positions, np.add(TRIANGLE, [0, 0.25 + 0.375, 0.5]))


def test_targets_without_weights_cost_nothing_until_they_have_some(writer):
    writer.mesh(targets=[{"POSITION": writer.accessor([[0, 1, 0]] * 3)}])
    (instance,) = writer.load()
    assert not instance.posed
    instance.morph_weights = [2]
    np.testing.assert_allclose(instance.posed_mesh().positions, np.add(TRIANGLE, [0, 2, 0]))


def test_two_skins_of_a_mesh(writer):
    lower, _ = skinned(writer)
    place = writer.node(translation=[5, 0, 0])
    other = writer.add("skins", joints=[place, place])
    writer.node(mesh=0, skin=other)
    writer.node(mesh=0)
    assert lower == 1
    first, second, bare = writer.load()
    assert first.mesh is second.mesh
    np.testing.assert_allclose(second.posed_mesh().positions, np.add(TRIANGLE, [5, 0, 0]))
    assert not bare.posed


def test_skins_below_a_mirrored_node_are_not_inside_out(writer):
    """The joints mirror the triangle, so that its corners must run the other way around, and bitangents too. A mesh
    without a skin stays as it is, for the transform of its instance says that it is mirrored."""
    attributes = {"NORMAL": [[0, 0, 1]] * 3, "TANGENT": [[1, 0, 0, 1]] * 3, "WEIGHTS_0": [[1, 0, 0, 0]] * 3,
                  "JOINTS_0": writer.accessor([[0, 0, 0, 0]] * 3, "u1")}  # fmt: skip
    mesh, skin = writer.mesh(attributes), writer.add("skins", joints=[0])
    writer.node()
    writer.node(mesh=mesh, skin=skin)
    writer.node(mesh=mesh)
    writer.node(children=[0, 1, 2], scale=[1, 1, -1])
    for scale, turned in ([1, 1, -1], True), ([1, 1, 1], False):
        writer.json["nodes"][3]["scale"] = scale
        skinned, bare = writer.load()
        assert skinned.mesh.triangles.tolist() == ([[2, 1, 0]] if turned else [[0, 1, 2]])
        assert skinned.mesh.tangents[:, 3].tolist() == [-1 if turned else 1] * 3
        assert bare.mesh.triangles.tolist() == [[0, 1, 2]]
        assert bare.mesh.tangents[:, 3].tolist() == [1] * 3


def test_a_clip_that_mirrors_a_skin_turns_its_triangles(writer):
    """While the clip mirrors the skin, and at a size of 0 as before. Both clips mirror the mesh without a skin too,
    whose transform says so."""
    attributes = {"WEIGHTS_0": [[1, 0, 0, 0]] * 3, "JOINTS_0": writer.accessor([[0, 0, 0, 0]] * 3, "u1")}
    mesh, skin = writer.mesh(attributes), writer.add("skins", joints=[0])
    writer.node()
    writer.node(mesh=mesh, skin=skin)
    writer.node(mesh=mesh, skin=skin)
    writer.node(mesh=mesh)
    above = writer.node(children=[0, 1, 2, 3])
    animate(writer, above, "scale", [0, 2], [[1, 1, 1], [1, 1, -1]])
    scene = writer.load()
    skinned, other, bare = scene
    right = skinned.mesh
    for seconds, turned in ((0, False), (0.5, False), (1, False), (1.5, True), (2, True), (1, True), (0.5, False)):
        scene.animate(seconds, 0, loop=False)
        assert skinned.mesh is other.mesh
        assert skinned.mesh.triangles.tolist() == ([[2, 1, 0]] if turned else [[0, 1, 2]])
        assert (skinned.mesh is right) is not turned
        assert bare.mesh.triangles.tolist() == [[0, 1, 2]]
        if seconds != 1:
            assert (np.linalg.det(bare.transform[:3, :3]) < 0) == turned


# ---- bad files --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": [[1, -0.5, 0, 0]] * 3}, "negative weights in WEIGHTS_0"),
        ({"weights": [[1, math.nan, 0, 0]] * 3}, "all values must be finite"),
        ({"weights": [[1, 0, 0, 0]] * 2}, "has 3 joints and 2 weights for 3 positions"),
        ({"joints": [[0, 7, 0, 0]] * 3}, "refers to joint 7, but the skin has 2 joints"),
    ],
)
def test_wrong_influences(writer, change, message):
    skinned(writer, **change)
    with pytest.raises(SolariError, match=message):
        writer.load()


def test_wrong_skins(writer):
    lower, upper = skinned(writer)
    skin = writer.json["skins"][0]
    one, huge = writer.accessor(np.eye(4).reshape(1, 16)), writer.accessor(np.full((2, 16), 1e30))
    for change, message in (
        ({"inverseBindMatrices": one}, "has 1 inverse bind matrices for 2 joints"),
        ({"joints": [lower, 99]}, "node 99"),
        ({"inverseBindMatrices": huge}, "a pose that can't be shown: .*joint_matrices"),
    ):
        writer.json["skins"][0] = skin | change
        with pytest.raises(SolariError, match=message):
            writer.load()
    writer.json["skins"][0] = skin
    writer.json["nodes"][upper]["children"] = [lower]
    with pytest.raises(SolariError, match="nodes form a tree"):
        writer.load()


def test_wrong_counts_of_morph_weights(writer):
    targets = [{"POSITION": writer.accessor([[0, 1, 0]] * 3)}] * 2
    node = writer.node(mesh=writer.mesh(targets=targets))
    animate(writer, node, "weights", [0, 1], [[0]] * 6)
    odd = writer.accessor([[0]] * 3)
    with pytest.raises(SolariError, match="has 3 weights for node 0, whose mesh has 2 morph targets"):
        writer.load()
    writer.json["animations"][0]["samplers"][0]["output"] = odd
    with pytest.raises(SolariError, match="has 3 values for 2 keys of weights"):
        writer.load()


def test_poses_that_can_not_be_shown(writer):
    lower, _ = skinned(writer)
    animate(writer, lower, "scale", [0, 1], [[1, 1, 1], [1e30, 1, 1]])
    scene = writer.load()
    with pytest.raises(SolariError, match=r"Animation at 0\.5 s: .*joint_matrices must lie within"):
        scene.animate(0.5)
    scene.animate(0)
    assert np.isfinite(scene.instances[0].posed_mesh().positions).all()
