"""Animations of nodes: keys between and at their times, hierarchies, cameras, lights, visibility, and bad files."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene.animation.keyframes import Channel

HALF = math.sqrt(0.5)
QUARTER = [0, HALF, 0, HALF]  # a quarter turn about y


# ---- keys -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "linear", "step"),
    [(0, 1, 1), (0.5, 1, 1), (1, 1, 1), (1.5, 3, 1), (2, 5, 5), (2.75, -2.5, 5), (3, -5, -5), (9, -5, -5)],
)
def test_linear_and_step_keys(seconds, linear, step):
    keys = [1, 2, 3], [[1, 0, 0], [5, 0, 0], [-5, 0, 0]]
    assert Channel(0, "translation", *keys).at(seconds).tolist() == [linear, 0, 0]
    assert Channel(0, "translation", *keys, "STEP").at(seconds).tolist() == [step, 0, 0]


def test_cubic_keys_follow_hermite_curves():
    """A cubic polynomial with its own derivatives as tangents is met exactly."""
    times = np.array([0.5, 2.0, 2.5])
    curve = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    values = np.stack([curve.deriv()(times), curve(times), curve.deriv()(times)], axis=1)[..., None] * [1.0, 2.0, 3.0]
    channel = Channel(0, "scale", times, values, "CUBICSPLINE")
    for seconds in np.linspace(0.5, 2.5, 33):
        np.testing.assert_allclose(channel.at(seconds), curve(seconds) * np.array([1, 2, 3]), rtol=1e-12, atol=1e-12)


def test_rotations_turn_at_constant_speed_along_the_shorter_arc():
    angle = 1.9
    end = [0, -math.sin(angle / 2), 0, -math.cos(angle / 2)]  # the opposite quaternion of the same rotation
    channel = Channel(0, "rotation", [0, 1], [[0, 0, 0, 1], end])
    for t in np.linspace(0, 1, 11):
        expected = np.array([0, math.sin(t * angle / 2), 0, math.cos(t * angle / 2)])
        assert abs(channel.at(t) @ expected) == pytest.approx(1, abs=1e-12)
        assert np.linalg.norm(channel.at(t)) == pytest.approx(1)
    assert Channel(0, "rotation", [0], [[0, 0, 0, 0]]).at(0).tolist() == [0, 0, 0, 1], "no length means no turn"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": []}, "at least one key"),
        ({"times": [1, 0]}, "descend"),
        ({"times": [-1, 0]}, "descend"),
        ({"times": [0, math.nan]}, "finite"),
        ({"values": [[1, 2], [3, 4]]}, r"must have \(2, 3\)"),
        ({"values": [[math.inf] * 3] * 2}, "finite"),
        ({"path": "color"}, "'color'"),
        ({"interpolation": "C"}, "C keys"),
    ],
)
def test_wrong_channels_are_refused(change, message):
    with pytest.raises(SolariError, match=message):
        Channel(**{"node": 0, "path": "scale", "times": [0, 1], "values": [[1, 1, 1]] * 2, **change})


# ---- nodes ------------------------------------------------------------------------------------------


def test_children_follow_their_animated_parents(writer):
    leaf = writer.node(mesh=writer.mesh(), translation=[1, 0, 0])
    turning = writer.node(children=[leaf], translation=[0, 2, 0])
    writer.node(children=[turning], scale=[2, 2, 2])
    still = writer.node(mesh=0, name="still")
    writer.animate(turning, "rotation", [0, 2], [[0, 0, 0, 1], QUARTER])
    writer.animate(turning, "translation", [0, 2], [[0, 2, 0], [0, 4, 0]])
    scene = writer.load()
    moving, fixed = scene.instances
    assert (scene.animations[0].name, scene.animations[0].duration) == ("clip", 2)
    before = fixed.transform
    scene.animate(1.0, "clip")
    expected = np.eye(4)  # half of the turn, and the scale of the root
    expected[:3] = 2 * np.array([[HALF, 0, HALF, HALF], [0, 1, 0, 3], [-HALF, 0, HALF, -HALF]])
    np.testing.assert_allclose(moving.transform, expected, atol=1e-6)
    assert fixed.transform is before
    assert still == 3
    assert not scene.warnings


def test_long_chains_of_nodes(writer):
    """Each of seven nodes is a step to the right of its parent, and turns by an eighth of a turn."""
    below = writer.node(mesh=writer.mesh(), translation=[1, 0, 0], name="end")
    for _ in range(7):
        below = writer.node(children=[below], translation=[1, 0, 0])
        writer.animate(below, "rotation", [0], [[0, math.sin(math.pi / 8), 0, math.cos(math.pi / 8)]])
    scene = writer.load()
    scene.animate(0)
    end = np.exp(-1j * math.pi / 4 * np.arange(8)).sum()  # x + iz, which a turn about y multiplies
    np.testing.assert_allclose(scene.instances[0].transform[[0, 2], 3], [end.real, end.imag], atol=1e-6)


def test_the_end_of_a_clip(writer):
    node = writer.node(mesh=writer.mesh())
    writer.animate(node, "translation", [0, 2], [[0, 0, 0], [4, 0, 0]])
    scene = writer.load()
    (instance,) = scene
    for seconds, looped, once in (
        (0.5, 1, 1),
        (2, 4, 4),
        (2 + 1e-15, 4, 4),
        (1.7e9 + 0.5, 1, 4),
        (2.5, 1, 4),
        (-0.5, 3, 0),
        (0, 0, 0),
    ):
        scene.animate(seconds)
        assert instance.transform[0, 3] == looped
        scene.animate(seconds, loop=False)
        assert instance.transform[0, 3] == once
    for wrong in (math.nan, math.inf, "soon"):
        with pytest.raises(SolariError, match="finite number of seconds"):
            scene.animate(wrong)
    with pytest.raises(SolariError, match="there is no animation 'run'"):
        scene.animate(0, "run")
    with pytest.raises(SolariError, match="there is no animation 3"):
        scene.animate(0, 3)


def test_clips_are_mixed(writer):
    """Positions and scales by weights, rotations half-way, with rest poses where a clip leaves a node alone."""
    leaf = writer.node(mesh=writer.mesh(), translation=[1, 0, 0])
    turning = writer.node(children=[leaf], rotation=QUARTER)
    writer.animate(turning, "rotation", [0], [[0, 0, 0, 1]])
    writer.animate(leaf, "translation", [0, 1], [[3, 0, 0], [5, 0, 0]])
    writer.clip("second")
    writer.animate(turning, "rotation", [0], [[0, -math.sqrt(0.75), 0, -0.5]])  # a third of a turn
    scene = writer.load()
    (instance,) = scene

    def seen():
        return instance.transform[:3, 0], instance.transform[:3, 3]

    scene.mix_clips(("clip", 0.5, 3.0), ("second", 0.0, 1.0))
    angle = 2 * math.atan2(math.sqrt(0.75), 0.5 + 3)  # the shorter way, by a normalized mean
    along = np.array([math.cos(angle), 0, -math.sin(angle)])
    for found, expected in zip(seen(), (along, along * (0.75 * 4 + 0.25 * 1)), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    for parts, alone in (([("clip", 0.5, 1), ("second", 0, 0)], ("clip", 0.5)), ([(1, 9, 2)], ("second", 9))):
        scene.mix_clips(*parts)
        mixed = seen()
        scene.animate(alone[1], alone[0])
        for found, expected in zip(seen(), mixed, strict=True):
            assert (found == expected).all()
    scene.animations.add(sv.Animation(scene.animations[0].rig, [Channel(0, "visible", [0], [[0]])], "hidden"))
    for weight, visible in ((0.9, True), (1.1, False)):
        scene.mix_clips(("clip", 0, 1), ("hidden", 0, weight))
        assert instance.visible == visible


def test_wrong_mixes_of_clips(writer):
    writer.animate(writer.node(mesh=writer.mesh()), "translation", [0], [[1, 0, 0]])
    scene, other = writer.load(), writer.load()
    scene.animations.add(other.animations[0])
    for parts, message in (
        ([], "of which one is more than 0"),
        ([(0, 0, 0)], "of which one is more than 0"),
        ([(0, 0, 1), (0, 0, -1)], "needs weights from 0 on"),
        ([(0, 0, math.nan)], "needs weights from 0 on"),
        ([(0, 0, 1), (1, 0, 1)], "only animations of one rig"),
        ([("run", 0, 1)], "there is no animation 'run'"),
        ([(0, math.inf, 1)], "finite number of seconds"),
        ([(0, 10**400, 1)], "finite number of seconds"),
        ([(0, 0, 1e308)] * 2, "needs weights from 0 on"),
    ):
        with pytest.raises(SolariError, match=message):
            scene.mix_clips(*parts)


def test_a_clip_leaves_other_nodes_in_their_rest_pose(writer):
    mesh = writer.mesh()
    nodes = [writer.node(mesh=mesh, translation=[0, n, 0]) for n in range(2)]
    writer.animate(nodes[0], "translation", [0], [[5, 0, 0]])
    writer.clip("second")
    writer.animate(nodes[1], "translation", [0], [[7, 0, 0]])
    scene = writer.load()
    for clip, places in ((1, [[0, 0], [7, 0]]), (0, [[5, 0], [0, 1]])):
        scene.animate(0, clip)
        assert [instance.transform[:2, 3].tolist() for instance in scene] == places


def test_instances_are_hidden_while_they_have_no_size_or_one_that_devices_cant_hold(writer):
    node = writer.node(mesh=writer.mesh(), scale=[0, 0, 0])
    writer.animate(node, "scale", [0, 1, 2], [[0, 0, 0], [2, 2, 2], [1e30, 1, 1]])
    scene = writer.load()
    (instance,) = scene
    assert not instance.visible
    for seconds, visible in ((0.5, True), (1.5, False), (0.25, True), (0, False)):
        scene.animate(seconds)
        assert instance.visible == visible
        if visible:
            assert instance.transform[0, 0] == 2 * seconds


def test_repeated_instances_cameras_and_lights_follow_their_nodes(writer):
    moved = writer.accessor([[1, 0, 0], [2, 0, 0]])
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1})
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "directional"}]}}
    children = [
        writer.node(mesh=writer.mesh(), extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moved}}}),
        writer.node(camera=camera, translation=[0, 1, 0]),
        writer.node(extensions={"KHR_lights_punctual": {"light": 0}}),
    ]
    root = writer.node(children=children)
    writer.animate(root, "rotation", [0, 1], [[0, 0, 0, 1], QUARTER])
    scene = writer.load()
    scene.animate(1, loop=False)
    np.testing.assert_allclose([i.transform[:3, 3] for i in scene], [[0, 0, -1], [0, 0, -2]], atol=1e-6)
    np.testing.assert_allclose(scene.cameras[0].transform[:3, [2, 3]], [[1, 0], [0, 1], [0, 0]], atol=1e-6)
    np.testing.assert_allclose(scene.lights[0].direction, [-1, 0, 0], atol=1e-6)


def test_a_scale_of_0_leaves_lights_in_the_scene(writer):
    """Scales mean nothing for lights; one without a direction of its own keeps the latest."""
    spot = {"type": "spot", "spot": {}}
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}, spot]}}
    leaves = [writer.node(extensions={"KHR_lights_punctual": {"light": light}}) for light in range(2)]
    root = writer.node(children=leaves)
    writer.animate(root, "scale", [0, 1], [[1, 1, 1], [0, 0, 0]])
    writer.animate(root, "translation", [0, 1], [[0, 0, 0], [0, 4, 0]])
    scene = writer.load()
    scene.animate(1, loop=False)
    assert [light.position.tolist() for light in scene.lights] == [[0, 4, 0]] * 2
    np.testing.assert_allclose(scene.lights[1].direction, [0, 0, -1], atol=1e-6)


def test_visibility_by_pointers(writer):
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "directional"}]}}
    light = writer.node(extensions={"KHR_lights_punctual": {"light": 0}})
    node = writer.node(mesh=writer.mesh(), children=[light])
    seen = writer.accessor([[1], [0], [1]], "u1")
    for pointer, times, values in (
        (f"/nodes/{node}/extensions/KHR_node_visibility/visible", [0, 1, 2], seen),
        ("/meshes/0/weights", [0], [[1.0]]),
    ):
        target = {"KHR_animation_pointer": {"pointer": pointer}}
        writer.animate(None, "pointer", times, values, "STEP", extensions=target)
    scene = writer.load()
    (instance,) = scene
    for seconds, seen in ((0.5, True), (1.5, False), (2, True)):
        scene.animate(seconds, loop=False)
        assert (instance.visible, len(scene.lights)) == (seen, seen)
    scene.animate(0.0)
    for light in list(scene.lights):
        scene.lights.remove(light)  # a clip that hides it later doesn't mind
    scene.animate(1.0)
    [warning] = scene.warnings
    assert warning.startswith("animations of some properties are not played: animation 0 'clip'")


# ---- bad files --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"values": [[0, 0, 0]]}, "has 1 values for 2 keys of translation"),
        ({"interpolation": "CUBICSPLINE"}, "three values of 3 numbers a key"),
        ({"times": [1, 0]}, "times from 0 on that ascend"),
        ({"times": [-1, 0]}, "times from 0 on that ascend"),
        ({"times": [0, math.nan]}, "must be finite"),
        ({"values": [[0, 0, math.inf]] * 2}, "must be finite"),
        ({"values": [[0, 0, 0, 0]] * 2}, "must be VEC3"),
        ({"interpolation": "SINE"}, "one of LINEAR, STEP, CUBICSPLINE"),
    ],
)
def test_wrong_keys_in_files(writer, fields, message):
    node = writer.node(mesh=writer.mesh())
    writer.animate(node, "translation", **{"times": [0, 1], "values": [[0, 0, 0]] * 2, **fields})
    writer.animate(node, "scale", [0, 3], [[1, 1, 1]] * 2)
    scene = writer.load_with_loss(f"(animation 0 'clip'|accessor).*{message}")
    assert [channel.path for channel in scene.animations["clip"].channels] == ["scale"], "a wrong channel costs itself"


def test_wrong_targets_in_files(writer):
    node = writer.node(mesh=writer.mesh(), matrix=np.eye(4).reshape(-1).tolist())
    writer.animate(node, "translation", [0], [[0, 0, 0]])
    channel = writer.json["animations"][0]["channels"][0]
    assert not writer.load_with_loss("is animated, so it can't have a 'matrix'").animations
    del writer.json["nodes"][0]["matrix"]
    for change, message in (
        ({"target": {"node": 9, "path": "scale"}}, "node 9"),
        ({"target": {"node": 0, "path": "spin"}}, "'path'"),
        ({"sampler": 3}, "refers to sampler 3"),
        ({"target": None}, "target"),
    ):
        writer.json["animations"][0]["channels"] = [channel | change]
        assert not writer.load_with_loss(message).animations
    writer.json["animations"][0] |= {"channels": 3}
    assert not writer.load_with_loss("'channels' is 3").animations
