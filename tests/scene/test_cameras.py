"""Cameras: lenses, orthographic ones, poses, and those of glTF files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.oracles import gbuffer

import solari_vk as sv
from solari_vk.errors import SolariError

BOX = np.array([[-1.0, 0, 2], [4, 1, 3]])


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
def test_framing_touches_the_pictures_edges(orthographic, aspect):
    camera = sv.Camera.framing(BOX, aspect=aspect, margin=1.0, orthographic=orthographic)
    assert bool(camera.orthographic_height) == orthographic
    picture = np.zeros((100, round(100 * aspect), 3))
    picture[:8, 0] = [[x, y, z] for x in BOX[:, 0] for y in BOX[:, 1] for z in BOX[:, 2]]
    seen = gbuffer.project(camera, picture)[:8, 0] / picture.shape[1::-1]
    assert np.abs(seen - 0.5).max() == pytest.approx(0.5, abs=1e-9)


def test_poses_keep_all_that_makes_the_picture():
    camera = sv.Camera.look_at((1, 2, 3), (0, 0, 0), aperture=0.1, focus_distance=3, near=0.2, ev100=5)
    for one in (camera, sv.Camera(transform=(0, 1, 0), orthographic_height=4)):
        again = sv.Camera.from_pose(one.pose())
        assert again.pose() == one.pose()


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
    with pytest.raises(SolariError, match="a perspective camera"):
        sv.Camera(orthographic_height=1).focus_on(1, 2)


@pytest.mark.parametrize(
    "fields", [{"orthographic_height": -1}, {"orthographic_height": 1e-30}, {"aperture": -1}, {"focus_distance": 0}]
)
def test_wrong_lenses(fields):
    with pytest.raises(SolariError, match=next(iter(fields))):
        sv.Camera(**fields)


@pytest.mark.parametrize(("lens", "height"), [({"ymag": 2, "znear": 0.5}, 4), ({"ymag": -2, "znear": 0}, 4)])
def test_orthographic_cameras_of_files(writer, lens, height):
    lens |= {"xmag": 3, "zfar": 100}
    camera = writer.add("cameras", type="orthographic", orthographic=lens, name="plan")
    writer.node(camera=camera, translation=[1, 2, 3])
    scene = writer.load()
    (camera,) = scene.cameras
    assert scene.warnings == []
    assert (camera.orthographic_height, camera.name) == (height, "plan")
    assert camera.near == pytest.approx(lens["znear"] or 4e-6)
    assert camera.transform[:3, 3].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("fields", "message"),
    [({}, "has no 'orthographic'"), ({"orthographic": {"ymag": "x", "znear": 0}}, "ymag"),
     ({"orthographic": {"ymag": 1}}, "znear")],
)  # fmt: skip
def test_damaged_orthographic_cameras(writer, fields, message):
    writer.node(camera=writer.add("cameras", type="orthographic", **fields))
    with pytest.raises(SolariError, match=message):
        writer.load()


def test_cameras_without_a_height_are_left_out(writer):
    writer.node(camera=writer.add("cameras", type="orthographic", orthographic={"ymag": 0, "znear": 1}))
    scene = writer.load()
    assert not scene.cameras
    assert "without a height" in scene.warnings[0]
