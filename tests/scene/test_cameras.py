"""Cameras: where they look, lenses, orthographic ones, poses, and those of glTF files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.rays import project

import solari_vk as sv
from solari_vk.base.errors import SolariError

BOX = np.array([[-1.0, 0, 2], [4, 1, 3]])


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_look_at():
    camera = sv.Camera.look_at([1, 2, 3], [1, 2, -7], vertical_fov=1, name="eye", ev100=3)
    np.testing.assert_allclose(camera.transform, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert (camera.vertical_fov, camera.name, camera.exposure) == (1, "eye", pytest.approx(1 / 9.6))
    assert camera.place([0, 5, 0], [0, 0, 0], up=[0, 0, -1], vertical_fov=0.5) is camera, "moves the camera"
    assert repr(camera) == "<Camera 'eye' at (0, 5, 0) towards (0, -1, 0), vertical_fov=0.5 (28.6 degrees), ev100=3>"
    np.testing.assert_allclose(camera.transform[:3, 2:], [[0, 0], [1, 5], [0, 0]])
    assert (camera.ev100, camera.vertical_fov) == (3, 0.5)
    for position in ([0, 0, 0], [0, 5, 0]):
        with pytest.raises(SolariError, match="must differ, and up must not lie along the view"):
            sv.Camera.look_at(position, [0, 0, 0])
    for position in ([math.nan, 0, 0], [math.inf, 0, 0], [1e308, -1e308, 0], [10**400, 0, 0]):
        with pytest.raises(SolariError, match="must be finite and not too far apart"):
            sv.Camera.look_at(position, [0, 1e308, 0])


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("aspect", [0.5, 3.0])
@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_framing_touches_the_pictures_edges(orthographic, aspect, scale):
    camera = sv.Camera.framing(scale * BOX, aspect=aspect, margin=1.1, orthographic=orthographic)
    assert bool(camera.orthographic_height) == orthographic
    corners = scale * np.array([[x, y, z] for x in BOX[:, 0] for y in BOX[:, 1] for z in BOX[:, 2]])
    picture = np.zeros((100, round(100 * aspect), 3))
    picture[:8, 0] = corners
    seen = project(camera, picture)[:8, 0] / picture.shape[1::-1]
    assert np.abs(seen - 0.5).max() == pytest.approx(0.5 / 1.1, abs=1e-6)
    depth = (camera.transform[:3, 3] - corners) @ camera.transform[:3, 2]
    assert (depth > camera.near).all()


def test_poses_keep_all_that_makes_the_picture():
    camera = sv.Camera.look_at((1, 2, 3), (4, 5, 7), aperture=0.1, focus_distance=3, near=0.2, ev100=5)
    for one in (camera, sv.Camera(transform=(0, 1, 0), orthographic_height=4)):
        again = sv.Camera.from_pose(one.pose())
        assert again.pose() == one.pose()
        np.testing.assert_allclose(again.transform, one.transform)
    aimed = sv.Camera.from_pose({"position": [1, 2, 3], "target": [4, 5, 7]})
    np.testing.assert_allclose(aimed.transform, camera.transform)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ([], "a JSON object of"),
        ({"eye": 1}, "a JSON object of"),
        ({"position": [0, 0, 0]}, "needs 'position' and"),
        ({"position": "x", "target": [0, 0, 0]}, "must be three numbers each, not 'x'"),
        ({"position": [10**400, 0, 0], "target": [0, 0, 0]}, "must be finite and not too far apart"),
        ({"transform": [[1]]}, "shape"),
        ({"position": [0, 0, 1], "target": [0, 0, 0], "vertical_fov_degrees": 200}, "vertical_fov"),
    ],
)
def test_poses_that_make_no_camera(pose, message):
    with pytest.raises(SolariError, match=message):
        sv.Camera.from_pose(pose)


def test_focus_as_photographers_set_it():
    camera = sv.Camera.look_at((0, 0, 5), (0, 0, 0), vertical_fov=2 * math.atan(0.012 / 0.05))  # a 50 mm lens
    assert camera.focus_on((3, 0, 1), f_number=2.0) is camera
    assert camera.focus_distance == pytest.approx(4)
    assert camera.aperture == pytest.approx(0.025)
    assert camera.focus_on(7.5, 1.4).focus_distance == 7.5
    for target, number in (((0, 0, 6), 2), (0, 2), (1, 0), (math.nan, 2)):
        with pytest.raises(SolariError, match="a target before it"):
            camera.focus_on(target, number)
    for target in ("a", (1, 2), ((1, 2), 2)):
        with pytest.raises(SolariError, match="target is a point"):
            camera.focus_on(target, 2)
    with pytest.raises(SolariError, match="a camera with a focal length"):
        sv.Camera(orthographic_height=1).focus_on(1, 2)


def test_perspective_cameras_of_files(writer):
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1, "aspectRatio": 2.0})
    writer.node(camera=camera, name="eye", translation=[1, 2, 3], scale=[2, 2, 2])
    scene = writer.load()
    (found,) = scene.cameras
    assert (found.name, found.vertical_fov, found.near) == ("eye", 0.7, 0.1)
    np.testing.assert_allclose(found.transform, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert scene.warnings == []


@pytest.mark.parametrize(("height", "near"), [(2, 0.5), (-2, 0)])
def test_orthographic_cameras_of_files(writer, height, near):
    lens = {"ymag": height, "znear": near, "xmag": 3, "zfar": 100}
    writer.node(camera=writer.add("cameras", type="orthographic", orthographic=lens, name="plan"))
    scene = writer.load()
    (camera,) = scene.cameras
    assert (camera.orthographic_height, camera.name, scene.warnings) == (4, "plan", [])
    assert camera.near == pytest.approx(near or 4e-6)


def test_damaged_orthographic_cameras(writer):
    writer.node(camera=writer.add("cameras"))
    for lens, message in (
        ({}, "has no 'orthographic'"),
        ({"orthographic": {"ymag": "x", "znear": 0}}, "ymag"),
        ({"orthographic": {"ymag": 1}}, "znear"),
    ):
        writer.json["cameras"] = [{"type": "orthographic", **lens}]
        assert not writer.load_with_loss(message).cameras
    writer.json["cameras"] = [{"type": "orthographic", "orthographic": {"ymag": 0, "znear": 1}}]
    scene = writer.load()
    assert not scene.cameras
    assert "without a height" in scene.warnings[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, "Run"), "there is no animation 'Run'; there are none"),
        (("wide",), "width / height of the picture, not 'wide'"),
        ((0.0,), "not 0.0"),
    ],
)
def test_what_camera_for_refuses(arguments, message):
    with pytest.raises(SolariError, match=message):
        sv.builtin("cornell_box").camera_for(*arguments)


def test_fov_is_vertical_fov_in_degrees():
    camera = sv.Camera.look_at((0, 0, 1), (0, 0, 0), fov=60)
    assert camera.vertical_fov == pytest.approx(math.radians(60))
    camera.fov = 30
    assert (camera.fov, camera.position.tolist()) == (pytest.approx(30), [0, 0, 1])
    camera.update(fov=20, position=(1, 2, 3))
    assert (camera.fov, camera.position.tolist()) == (pytest.approx(20), [1, 2, 3])
    for wrong in (0, 361, float("nan"), "wide"):
        with pytest.raises(SolariError, match="Camera: fov"):
            camera.fov = wrong


def test_fields_of_view_in_radians_are_noticed():
    with pytest.warns(UserWarning, match=r"fov is in degrees, .* in radians it is vertical_fov=0.7"):
        assert sv.Camera(fov=0.7).fov == pytest.approx(0.7)
