"""Skins and morph targets of glTF files: their arrays, their animations, and bad files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.files import TRIANGLE

import solari_vk as sv
from solari_vk.base.errors import SolariError

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
    writer.node(mesh=number, skin=skin, translation=[100, 0, 0])
    return lower, upper


def test_joints_follow_their_nodes(writer):
    lower, upper = skinned(writer)
    writer.animate(upper, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]])
    writer.clip("away")
    writer.animate(lower, "translation", [0, 1], [[0, 0, 0], [8, 0, 0]])
    scene = writer.load()
    (instance,) = scene
    assert instance.mesh.deformation.joints.shape == (3, 2), "weights that are 0 everywhere are left out"
    np.testing.assert_allclose(instance.posed_mesh().positions, TRIANGLE, atol=1e-7)
    assert instance.transform.tolist() == np.eye(4).tolist(), "the node's own transform has no effect"
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
    writer.node(mesh=mesh)
    writer.animate(node, "weights", [0, 1], [[0], [0], [2], [4]])
    scene = writer.load()
    scene.animations.add(sv.Animation(scene.animations[0].rig, [], "rest"))
    moved, other = scene
    assert moved.mesh is other.mesh

    def check(*offsets):
        for instance, offset in zip(scene, offsets, strict=True):
            np.testing.assert_allclose(instance.posed_mesh().positions, np.add(TRIANGLE, offset))

    check([0, 0.5, 0], [0, 0.5, 0])
    scene.animate(0.5)
    check([0, 1, 2], [0, 0.5, 0])
    scene.mix_clips((0, 0.5, 1), ("rest", 0, 3))
    check([0, 0.25 + 0.375, 0.5], [0, 0.5, 0])


def test_targets_without_weights_cost_nothing_until_they_have_some(writer):
    writer.mesh(targets=[{"POSITION": writer.accessor([[0, 1, 0]] * 3)}])
    (instance,) = writer.load()
    assert not instance.posed
    instance.morph_weights = [2]
    np.testing.assert_allclose(instance.posed_mesh().positions, np.add(TRIANGLE, [0, 2, 0]))


def test_two_skins_of_a_mesh(writer):
    """Which may be without inverse bind matrices."""
    skinned(writer)
    place = writer.node(translation=[5, 0, 0])
    writer.node(mesh=0, skin=writer.add("skins", joints=[place, place]))
    writer.node(mesh=0)
    first, second, bare = writer.load()
    assert first.mesh is second.mesh
    np.testing.assert_allclose(second.posed_mesh().positions, np.add(TRIANGLE, [5, 0, 0]))
    assert not bare.posed


def mirrored(writer, scale, skins=1):
    """The root, with a scale, above a joint, a triangle on it once for each skin, and one without a skin."""
    attributes = {
        "NORMAL": [[0, 0, 1]] * 3,
        "TANGENT": [[1, 0, 0, 1]] * 3,
        "WEIGHTS_0": [[1, 0, 0, 0]] * 3,
        "JOINTS_0": writer.accessor([[0, 0, 0, 0]] * 3, "u1"),
    }
    mesh, joint = writer.mesh(attributes), writer.node()
    skin = writer.add("skins", joints=[joint])
    leaves = [writer.node(mesh=mesh, skin=skin) for _ in range(skins)]
    return writer.node(children=[joint, *leaves, writer.node(mesh=mesh)], scale=scale)


def check_turned(mesh, turned):
    """Whether the corners run the other way around, and the bitangents too."""
    assert mesh.triangles.tolist() == ([[2, 1, 0]] if turned else [[0, 1, 2]])
    assert mesh.tangents[:, 3].tolist() == [-1 if turned else 1] * 3


@pytest.mark.parametrize("depth", [1, -1])
def test_skins_below_a_mirrored_node_are_not_inside_out(writer, depth):
    """The joints mirror the triangle. One without a skin stays, for the transform of its instance mirrors it."""
    mirrored(writer, [1, 1, depth])
    skinned, bare = writer.load()
    check_turned(skinned.mesh, depth < 0)
    check_turned(bare.mesh, False)


def test_a_clip_that_mirrors_a_skin_turns_its_triangles(writer):
    """While the clip mirrors the skin, and at a size of 0 as before."""
    root = mirrored(writer, [1, 1, 1], skins=2)
    writer.animate(root, "scale", [0, 2], [[1, 1, 1], [1, 1, -1]])
    scene = writer.load()
    skinned, other, bare = scene
    right = skinned.mesh
    for seconds, turned in ((0, False), (0.5, False), (1, False), (1.5, True), (2, True), (1, True), (0.5, False)):
        scene.animate(seconds, 0, loop=False)
        assert skinned.mesh is other.mesh
        check_turned(skinned.mesh, turned)
        assert (skinned.mesh is right) is not turned
        check_turned(bare.mesh, False)
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
    writer.node(mesh=writer.mesh())
    scene = writer.load_with_loss(message)
    assert [instance.mesh.deformation for instance in scene] == [None] * len(scene.instances)
    assert len(scene.instances) == 1 + ("skin has" not in message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: {"inverseBindMatrices": w.accessor(np.eye(4).reshape(1, 16))}, "has 1 inverse bind matrices for 2"),
        (lambda w: {"inverseBindMatrices": w.accessor(np.full((2, 16), np.nan))}, "must be finite"),
        (lambda w: {"joints": [0, 99]}, "node 99"),
        (lambda w: {"inverseBindMatrices": w.accessor(np.full((2, 16), 1e30))}, "that can't be shown: .*joint_matrice"),
    ],
)
def test_wrong_skins(writer, change, message):
    skinned(writer)
    writer.node(mesh=writer.mesh())
    writer.json["skins"][0] |= change(writer)
    scene = writer.load_with_loss(message)
    assert not any(instance.posed for instance in scene)
    assert len(scene.instances) == 1 + ("be shown" not in message)


def test_nodes_that_form_no_tree(writer):
    skinned(writer)
    writer.json["nodes"][0].update(children=[1])
    writer.scene(1, 2)
    with pytest.raises(SolariError, match="nodes form a tree"):
        writer.load()


def test_wrong_counts_of_morph_weights(writer):
    targets = [{"POSITION": writer.accessor([[0, 1, 0]] * 3)}] * 2
    node = writer.node(mesh=writer.mesh(targets=targets))
    writer.animate(node, "weights", [0, 1], [[0]] * 6)
    odd = writer.accessor([[0]] * 3)
    assert not writer.load_with_loss("has 3 weights for node 0, whose mesh has 2 morph targets").animations
    writer.json["animations"][0]["samplers"][0]["output"] = odd
    assert not writer.load_with_loss("has 3 values for 2 keys of weights").animations


def test_poses_that_can_not_be_shown(writer):
    lower, _ = skinned(writer)
    writer.animate(lower, "scale", [0, 1], [[1, 1, 1], [1e30, 1, 1]])
    scene = writer.load()
    with pytest.raises(SolariError, match=r"Animation 'clip' at 0\.5 s: .*joint_matrices must lie within"):
        scene.animate(0.5)
    scene.animate(0)
    assert np.isfinite(scene.instances[0].posed_mesh().positions).all()
