"""Cameras as OpenCV, COLMAP and Nerfstudio write them: padding, rounding errors, binary files, worlds of their own."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.data.datasets.dataset import cameras_for

SIZE = (640, 480)
K = np.array([[520.0, 0, 331.2], [0, 498.0, 228.7], [0, 0, 1]])
POINTS = np.random.default_rng(1).uniform((-1, -1, 2), (1, 1, 6), (50, 3))


def camera(matrix=K, distortion=(), **fields):
    return sv.Camera.from_opencv(matrix, np.eye(3), (0.1, 0, 0), SIZE, distortion, **fields)


def test_what_opencv_returns():
    """Of a calibration with all its flags, and of a decomposed projection matrix."""
    cv2 = pytest.importorskip("cv2")
    board = np.stack(np.meshgrid(np.arange(9), np.arange(6), [0]), -1).reshape(-1, 3).astype(np.float32)
    turns = np.random.default_rng(2).uniform(-0.4, 0.4, (12, 3))
    lens = np.array((-0.2, 0.05, 0.001, -0.002, 0.0))
    seen = [cv2.projectPoints(board, turn, np.array((-4.0, -2.5, 12)), K, lens)[0] for turn in turns]
    flags = cv2.CALIB_RATIONAL_MODEL
    _, matrix, found, rotations, shifts = cv2.calibrateCamera(
        [board] * 12, [one.astype(np.float32) for one in seen], SIZE, None, None, flags=flags
    )
    assert found.size == 14
    made = sv.Camera.from_opencv(matrix, rotations[0], shifts[0], SIZE, distortion=found)
    np.testing.assert_allclose(made.project(board.astype(float), SIZE), seen[0].reshape(-1, 2), atol=0.01)
    projection = 0.01 * K @ np.hstack([cv2.Rodrigues(turns[0])[0], [[0.1], [0.2], [3]]])
    decomposed = cv2.decomposeProjectionMatrix(projection)[0]
    for matrix in (decomposed, K + np.eye(3, k=1) * (1, -2.8e-14, 1) * (0, 1, 0)):
        np.testing.assert_allclose(camera(matrix, None).intrinsics(SIZE), K, atol=1e-9)
    for terms in ((-0.2, 0.05, 0, 0), (-0.2, 0.05, 0.001, -0.002, 0.01)):
        padded = np.array([[*terms, *[0.0] * (14 - len(terms))]])
        np.testing.assert_allclose(camera(K, padded).project(POINTS, SIZE), camera(K, terms).project(POINTS, SIZE))
    with pytest.raises(SolariError, match="numbers, not 14"):
        camera(K, [*[0.0] * 12, 0.01, 0])
    # The last row moves pixels by its products with them, whatever the focal length is.
    with pytest.raises(SolariError, match="no skew"):
        camera(K + np.array([[0, 0, 0], [0, 0, 0], [1e-7, 0, 0]]))


MODELS = {
    "SIMPLE_RADIAL": "500 320 240 -0.1",
    "RADIAL": "500 320 240 -0.1 0.02",
    "SIMPLE_RADIAL_FISHEYE": "300 320 240 -0.02",
    "RADIAL_FISHEYE": "300 320 240 -0.02 0.003",
    "THIN_PRISM_FISHEYE": "300 310 320 240 -0.02 0.003 0 0 0.001 -0.0002 0 0",
    "OPENCV": "500 510 320 240 -0.1 0.02 0.001 -0.002",
}


@pytest.mark.parametrize("model", MODELS)
def test_models_and_binary_files_of_colmap(tmp_path, model):
    pycolmap = pytest.importorskip("pycolmap")
    text, binary = tmp_path / "text", tmp_path / "binary"
    text.mkdir()
    binary.mkdir()
    (text / "cameras.txt").write_text(f"7 {model} 640 480 {MODELS[model]}\n")
    (text / "images.txt").write_text("3 0.98 0.1 -0.1 0.14 0.1 0.2 0.3 7 a.png\n\n")
    (text / "points3D.txt").write_text("")
    theirs = pycolmap.Reconstruction(str(text))
    theirs.write_binary(str(binary))
    for folder in (text, binary):
        (image,) = sv.load_colmap(folder)
        assert (image.name, image.size) == ("a.png", SIZE)
        (other,) = theirs.images.values()
        wanted = np.array([other.project_point(point) for point in POINTS]) - 0.5
        np.testing.assert_allclose(image.camera.project(POINTS, SIZE), wanted, atol=1e-4)
    (binary / "cameras.txt").write_text("# of another model")
    assert len(sv.load_colmap(binary)) == 1, "both binary files are there, and one as text"
    data = (binary / "images.bin").read_bytes()
    (binary / "images.bin").write_bytes(data[:-9])
    with pytest.raises(SolariError, match=r"images\.bin: is cut off"):
        sv.load_colmap(binary)
    (text / "cameras.txt").write_text(f"7 THIN_PRISM_FISHEYE 640 480 {MODELS['THIN_PRISM_FISHEYE'][:-1]}0.1\n")
    with pytest.raises(SolariError, match="tangential or thin prism terms can't be shown"):
        sv.load_colmap(text)


def test_worlds_of_transforms_json(tmp_path):
    """Nerfstudio says what it has applied to the cameras, whose scene is in the world before."""
    path = tmp_path / "transforms.json"
    world = sv.Camera.look_at((3, 1, 2), (0, 0, 0)).transform
    applied = np.array([[0, 0, 1, 2], [1, 0, 0, 0], [0, 1, 0, -1.0]])
    pose = np.vstack([applied, (0, 0, 0, 1)]) @ world
    pose[:3, 3] *= 0.5
    content = {"camera_angle_x": 1.0, "applied_transform": applied.tolist(), "applied_scale": 0.5}

    def read(matrix):
        path.write_text(json.dumps(content | {"frames": [{"transform_matrix": matrix.tolist()}]}))
        return cameras_for(str(path), sv.Scene(), sv.Camera(), None, 1.0, 0)

    np.testing.assert_allclose(read(pose)[0].transform, world, atol=1e-12)
    with pytest.raises(SolariError, match="left-handed, which would mirror the picture"):
        read(pose * (-1, 1, 1, 1))
    with np.errstate(all="raise"), pytest.raises(SolariError, match=r"axes of the lengths \[.*0\.0"):
        read(pose * (1, 0, 1, 1))
    for wrong in (None, 2, np.eye(3), np.diag((1, 1, -1, 1)), np.diag((1, 2, 1, 1)), np.zeros((4, 4)), 2 * np.eye(4)):
        content["applied_transform"] = wrong.tolist() if isinstance(wrong, np.ndarray) else wrong
        with pytest.raises(SolariError, match="applied_transform isn't a rotation"):
            read(pose)
    content |= {"applied_transform": np.eye(4).tolist(), "applied_scale": -1}
    with pytest.raises(SolariError, match=r"applied_scale is -1.0, not above 0"):
        read(pose)


def test_data_sets_from_the_scenes_own_cameras():
    scene = sv.Scene(sv.Instance(sv.shapes.sphere(1.0)))
    front, top = (scene.add(sv.Camera(position=(0, 1, z), name=name)) for name, z in (("front", 3), ("top", 5)))

    def positions(kind, count=None):
        return [camera.position.tolist() for camera in cameras_for(kind, scene, sv.Camera(), count, 1.0, 0)]

    both = [front.position.tolist(), top.position.tolist()]
    assert positions("file") == both
    assert positions("file", 1) == both[:1]
    assert positions("top,front") == both[::-1]
    with pytest.raises(SolariError, match=r"that is 2 cameras, --views asks for 3"):
        positions("file", 3)
    scene.cameras["top"].name = "orbit"
    assert len(positions("orbit", 3)) == 3, "the words mean what they always do"
    with pytest.raises(SolariError, match=r"nor a camera's name"):
        positions("front,side")


def test_left_handed_cameras_are_warned_of():
    with pytest.warns(UserWarning, match="left-handed, so that pictures are mirrored"):
        mirrored = sv.Camera(transform=np.diag([-1, 1, 1, 1]))
    with warnings.catch_warnings(action="error"):
        mirrored.update(transform=np.eye(4), position=(1, 2, 3))
