"""Rigs: cameras keep their places on the body, cubes see every direction once, stereo pairs are a baseline apart."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene.matrices import rotation


def test_cameras_move_with_the_body():
    """The pixel of a point that moves with the body stays."""
    rng = np.random.default_rng(1)
    cameras = {
        "front": sv.Camera(position=(0, 0.1, -0.2), projection="fisheye", vertical_fov=2.5),
        "side": sv.Camera.look_at((0.3, 0, 0), (2, 0.2, -1), distortion=(-0.1, 0.01, 0, 0), ev100=3),
    }
    rig = sv.CameraRig(cameras)
    body = np.eye(4)
    body[:3, :3], body[:3, 3] = rotation(rng.normal(size=3), 0.7), (3, -2, 1)
    assert len(rig) == 2
    for before, after in zip(cameras.values(), rig.at(body), strict=True):
        origins, along = before.rays(rng.uniform(0, (63, 47), (50, 2)), (64, 48))
        points = origins + 3 * along
        moved = points @ body[:3, :3].T + body[:3, 3]
        np.testing.assert_allclose(after.project(moved, (64, 48)), before.project(points, (64, 48)), atol=1e-6)
        assert after.ev100 == before.ev100
    np.testing.assert_allclose(rig.at(position=(1, 2, 3))[0].position, (1, 2.1, 2.8))


def test_a_cube_sees_each_direction_once():
    directions = np.random.default_rng(2).normal(size=(2000, 3))
    cameras = sv.CameraRig.cube(near=0.1).at(position=(5, 0, 1))
    pixels = np.stack([camera.project(directions + np.array((5, 0, 1)), (16, 16)) for camera in cameras])
    inside = ((pixels >= -0.5) & (pixels < 15.5)).all(axis=-1)
    assert (inside.sum(axis=0) == 1).all()
    largest = np.abs(directions).argmax(axis=1)
    expected = 2 * largest + (np.take_along_axis(directions, largest[:, None], 1)[:, 0] < 0)
    assert np.array_equal(inside.argmax(axis=0), expected)


def test_a_stereo_pair():
    left, right = sv.CameraRig.stereo(sv.Camera(vertical_fov=0.7), 0.12).at(position=(0, 1, 5), rotation=0.4)
    point = left.rays((20, 30), (64, 48))[0] + 2 / 0.9 * left.rays((20, 30), (64, 48))[1]
    depth = -((point - left.position) @ left.rotation)[2]
    shift = left.project(point, (64, 48)) - right.project(point, (64, 48))
    np.testing.assert_allclose(shift, (left.intrinsics((64, 48))[0, 0] * 0.12 / depth, 0), atol=1e-9)
    for one in sv.CameraRig.stereo(sv.Camera(projection="equirectangular"), 0.06).at():
        assert one.projection == "equirectangular"
        assert abs(one.position[0]) == 0.03
    camera = sv.Camera.look_at((1, 2, 3), (0, 0, 0))
    left, right = sv.CameraRig.stereo(camera, 0.2).at()
    np.testing.assert_allclose((left.position + right.position) / 2, camera.position, atol=1e-12)
    np.testing.assert_allclose(camera.rotation.T @ (right.position - left.position), (0.2, 0, 0), atol=1e-12)


def test_wrong_rigs():
    for wrong, words in (({}, "at least one"), ([sv.Camera()], "cameras by name"), ({"a": 1}, "cameras by name")):
        with pytest.raises(SolariError, match=words):
            sv.CameraRig(wrong)


def test_faces_of_a_cube_are_parts_of_a_panorama(device):
    """Rendered in one call: each face shows what the panorama shows in its directions."""
    scene = sv.builtin("cornell_box")
    place, size = (1.0, 1.0, 0.7), (24, 24)
    with sv.Batch(device, scene, size, 6, outputs=["position", "instance_id"]) as batch:
        cameras = sv.CameraRig.cube().at(position=place)
        faces = batch.render(cameras)["instance_id"]
        positions = batch["position"]
    wide, panorama = (192, 96), sv.Camera(position=place, projection="equirectangular")
    with sv.Batch(device, scene, wide, 1, outputs=["instance_id"]) as batch:
        whole = batch.render([panorama])["instance_id"][0]
    there = faces != 2**32 - 1
    column, row = np.rint(panorama.project(positions[there], wide)).astype(int).T
    assert np.mean(whole[np.clip(row, 0, 95), column % 192] == faces[there]) > 0.97
    assert len(np.unique(faces)) >= 5
