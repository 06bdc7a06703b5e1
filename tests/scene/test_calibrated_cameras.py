"""Calibrated cameras: points and rays are where OpenCV says, matrices come back, and what can't be is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError

cv2 = pytest.importorskip("cv2")

SIZE = (640, 480)
K = np.array([[520.0, 0, 331.2], [0, 498.0, 228.7], [0, 0, 1]])
FISHEYE_K = np.array([[200.0, 0, 331.2], [0, 205.0, 228.7], [0, 0, 1]])
TURN, SHIFT = np.array((0.3, -0.5, 0.2)), np.array((0.1, -0.2, 0.4))
R = cv2.Rodrigues(TURN)[0]
TWELVE = (0.1, -0.2, 0.001, 0.0005, 0.05, 0.2, -0.1, 0.02, 0.001, -0.002, 0.003, 0.001)
BROWN = {
    "none": (),
    "four": (-0.28, 0.07, 0.001, -0.002),
    "five": (-0.28, 0.07, 0.001, -0.002, 0.01),
    "rational": TWELVE[:8],
    "thin prism": TWELVE,
}
KANNALA = {"equidistant": (0, 0, 0, 0), "wide": (0.05, -0.01, 0.003, -0.0005), "narrow": (-0.02, 0.01, -0.004, 6e-4)}


def random_pixels(count=10_000):
    return np.random.default_rng(3).uniform(-0.5, np.array(SIZE) - 0.5, (count, 2))


@pytest.mark.parametrize("name", BROWN)
def test_points_are_where_opencv_projects_them(name):
    """The points of 10,000 pixels, from all over the picture, at random distances."""
    camera = sv.Camera.from_opencv(K, np.reshape(TURN, (3, 1)), SHIFT, SIZE, BROWN[name])
    np.testing.assert_allclose(camera.transform, sv.Camera.from_opencv(K, R, SHIFT, SIZE).transform, atol=1e-12)
    pixels = random_pixels()
    origins, directions = camera.rays(pixels, SIZE)
    points = origins + directions * np.random.default_rng(4).uniform(0.5, 20, (len(pixels), 1))
    expected = cv2.projectPoints(points, TURN, SHIFT, K, np.array(BROWN[name] or (0.0,) * 4))[0][:, 0]
    np.testing.assert_allclose(camera.project(points, SIZE), expected, atol=1e-6)
    np.testing.assert_allclose(expected, pixels, atol=1e-6)


@pytest.mark.parametrize("name", KANNALA)
def test_a_fisheye_is_opencvs(name):
    """OpenCV's own works before the camera only; ours takes its 10,000 points and the picture's pixels beyond."""
    camera = sv.Camera.from_opencv(FISHEYE_K, R, SHIFT, SIZE, KANNALA[name], projection="fisheye")
    seen = np.random.default_rng(5).normal(size=(10_000, 3))
    seen[:, 2] = np.abs(seen[:, 2]) + 0.05
    points = (seen - SHIFT) @ R
    distortion = np.array(KANNALA[name], float)
    expected = cv2.fisheye.projectPoints(points[:, None], TURN, SHIFT, FISHEYE_K, distortion)[0][:, 0]
    np.testing.assert_allclose(camera.project(points, SIZE), expected, atol=1e-6)
    check_round_trip(camera)


def check_round_trip(camera, size=SIZE):
    """Rays of the picture's pixels lead back to them."""
    pixels = random_pixels()
    origins, directions = camera.rays(pixels, size)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1)
    np.testing.assert_allclose(camera.project(origins + 3 * directions, size), pixels, atol=1e-6)


def test_projections_in_closed_form():
    size = (200, 100)
    across = np.array((math.sin(1.2), 0, -math.cos(1.2)))  # 1.2 radians to the right of the view axis
    behind = np.array((1e-9, 0.6, 0.8))
    for projection, fov, radius in (
        ("fisheye", 3.0, 1.2 / 1.5),
        ("equidistant", 3.6, 1.2 / 1.8),
        ("stereographic", 4.0, math.tan(0.6) / math.tan(1)),
    ):
        camera = sv.Camera(projection=projection, vertical_fov=fov)
        np.testing.assert_allclose(camera.project(across, size), (99.5 + 50 * radius, 49.5), atol=1e-9)
        check_round_trip(camera)
    panorama = sv.Camera(projection="equirectangular")
    np.testing.assert_allclose(panorama.project(across, size), (99.5 + 200 * 1.2 / math.tau, 49.5), atol=1e-9)
    sky = 49.5 - 100 * math.asin(0.6) / math.pi
    np.testing.assert_allclose(panorama.project(behind, size), (199.5, sky), atol=1e-6)
    check_round_trip(panorama)
    flat = sv.Camera(orthographic_height=2.0)
    np.testing.assert_allclose(flat.project((0.5, 0.25, -7), size), (99.5 + 25, 49.5 - 12.5))
    check_round_trip(flat)
    assert np.isnan(flat.project((0, 0, 1), size)).all()
    assert np.isnan(sv.Camera().project((0, 0, 1), size)).all()


def test_matrices_come_back():
    for k, projection in ((K, "perspective"), (FISHEYE_K, "fisheye"), (FISHEYE_K, "stereographic")):
        camera = sv.Camera.from_opencv(k, R, SHIFT, SIZE, projection=projection, near=0.2)
        np.testing.assert_allclose(camera.intrinsics(SIZE), k, atol=1e-9)
        halved = camera.intrinsics((320, 240))
        np.testing.assert_allclose(halved[:2, :2], k[:2, :2] / 2)
        np.testing.assert_allclose(halved[:2, 2] + 0.5, (k[:2, 2] + 0.5) / 2)
        rotation, shift = camera.extrinsics()
        np.testing.assert_allclose(rotation, R, atol=1e-12)
        np.testing.assert_allclose(shift, SHIFT, atol=1e-12)
        again = sv.Camera.from_pose(camera.pose())
        np.testing.assert_allclose(again.intrinsics(SIZE), k, atol=1e-9)
        assert (again.projection, again.near) == (projection, 0.2)
    plain = sv.Camera(vertical_fov=math.radians(45))
    np.testing.assert_allclose(plain.intrinsics(SIZE)[:2, 2], (319.5, 239.5))
    assert plain.pose().keys().isdisjoint(("projection", "distortion"))


def test_points_of_depths():
    """`unproject` is the inverse of depth: along the axis in perspective, along the ray in wide projections."""
    pixels = random_pixels(100)
    near = sv.Camera.from_opencv(K, R, SHIFT, SIZE, BROWN["five"])
    depths = near.unproject(pixels, np.full(100, 3.0), SIZE) @ R.T + SHIFT
    np.testing.assert_allclose(depths[:, 2], 3.0)
    wide = sv.Camera(projection="fisheye", vertical_fov=3.0)
    np.testing.assert_allclose(np.linalg.norm(wide.unproject(pixels, np.full(100, 3.0), SIZE), axis=-1), 3.0)


def test_an_image_circle_is_black_around():
    """The corners of a picture whose lens sees 180 degrees; a distortion may fold beyond the circle."""
    camera = sv.Camera(projection="fisheye", vertical_fov=math.pi, image_circle=math.pi, distortion=(-0.1, 0, 0, 0))
    _, directions = camera.rays(np.array(((319.5, 239.5), (0, 0))), SIZE)
    assert np.isnan(directions).all(axis=-1).tolist() == [False, True]
    assert np.isnan(camera.project((0, 0, 1), SIZE)).all()
    assert np.isfinite(camera.project((1, 0, -0.1), SIZE)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": K * np.nan}, r"K must be finite, but element \(0, 0\) is nan"),
        ({"K": K + np.eye(3, k=1) * (1, 1, 0)}, "no skew, not"),
        ({"K": -K}, "fx and fy above 0"),
        ({"K": np.eye(4)}, "K must have the shape"),
        ({"R": np.zeros((3, 3))}, "R is a rotation"),
        ({"R": R * [1, 1, -1]}, "or it mirrors"),
        ({"R": R * 1.01}, "perpendicular and of length 1"),
        ({"t": (0, math.inf, 0)}, "t must be finite"),
        ({"size": (640, 0)}, "size is"),
        ({"distortion": (1, 2, 3)}, "0 or 4 or 5 or 8 or 12 numbers, not 3"),
        ({"distortion": (0.1, math.nan, 0, 0)}, "distortion must be finite"),
        ({"distortion": (-0.9, 0, 0, 0)}, "-0.9, 0, 0, 0 isn't invertible in a picture of 640x480.*check the order"),
        ({"distortion": (-0.3, 0, 0, 0), "projection": "fisheye", "K": FISHEYE_K}, "beyond 60.3.* give image_circle"),
        (
            {"projection": "fisheye", "K": [[30, 0, 320], [0, 30, 240], [0, 0, 1]]},
            "vertical_fov must be a finite number",
        ),
        ({"projection": "fish"}, "projection must be one of perspective, fisheye"),
        ({"image_circle": 3}, "a perspective camera has no image_circle"),
        ({"projection": "stereographic", "eye_offset": 0.1}, "a stereographic camera has no eye_offset"),
    ],
)
def test_what_is_no_camera(change, message):
    given = {"K": K, "R": R, "t": SHIFT, "size": SIZE, **change}
    with pytest.raises(SolariError, match=message):
        sv.Camera.from_opencv(**given)


def test_what_lenses_refuse():
    with pytest.raises(SolariError, match=r"at most pi .* a fisheye sees more"):
        sv.Camera(vertical_fov=3.2)
    with pytest.raises(SolariError, match="has no pixel_aspect or principal_point"):
        sv.Camera(projection="equirectangular", pixel_aspect=2, principal_point=(0.4, 0.5))
    with pytest.raises(SolariError, match="have no intrinsic matrix"):
        sv.Camera(projection="equirectangular").intrinsics(SIZE)
    with pytest.raises(SolariError, match=r"points have the shape \(..., 3\)"):
        sv.Camera().project((1, 2), SIZE)
    with pytest.raises(SolariError, match="a camera with a focal length"):
        sv.Camera(projection="equirectangular").focus_on(1, 2)
    for blades in (2, -1, 3.5):
        with pytest.raises(SolariError, match="aperture_blades must be 0, for a disk, or a whole number from 3"):
            sv.Camera(aperture_blades=blades)


def test_a_cube_is_six_cameras():
    """Pixels of the row of faces look where those of CameraRig.cube look, and points come back to them."""
    size, cube = (96, 16), sv.Camera(projection="cube", position=(1, 2, 3), rotation=0.4)
    faces = sv.CameraRig.cube().at(cube.transform)
    pixels = np.random.default_rng(1).uniform(-0.5, 15.5, (50, 2))
    for number, face in enumerate(faces):
        origins, expected = face.rays(pixels, (16, 16))
        shifted = pixels + np.array((16 * number, 0))
        found = cube.rays(shifted, size)
        np.testing.assert_allclose(found, (origins, expected), atol=1e-9)
        points = cube.unproject(shifted, np.full(50, 3.0), size)
        np.testing.assert_allclose(points, origins + 3 * expected, atol=1e-9)
        np.testing.assert_allclose(cube.project(points, size), shifted, atol=1e-6)


def test_omnidirectional_stereo():
    """Eyes stay beside each other in every direction; points come back to their pixels, and those between the eyes
    aren't seen."""
    size = (360, 180)
    left, right = sv.CameraRig.omnidirectional(0.2).at(position=(1, 0, 2))
    pixels = np.random.default_rng(2).uniform((-0.5, 20), (359.5, 160), (100, 2))
    for camera, side in ((left, -1), (right, 1)):
        origins, along = camera.rays(pixels, size)
        beside = origins - (1, 0, 2)
        np.testing.assert_allclose(np.linalg.norm(beside, axis=1), 0.1)
        np.testing.assert_allclose(np.einsum("ni,ni->n", beside, along), 0, atol=1e-9)
        flat = along * (1, 0, 1) / np.linalg.norm(along * (1, 0, 1), axis=1, keepdims=True)
        np.testing.assert_allclose(np.cross(flat, beside)[:, 1], -0.1 * side)
        points = camera.unproject(pixels, np.full(100, 2.5), size)
        np.testing.assert_allclose(points, origins + 2.5 * along)
        np.testing.assert_allclose(camera.project(points, size), pixels, atol=1e-6)
        assert np.isnan(camera.project((1.05, 3, 2), size)).all()
    shift = left.project((1, 0, -1), size) - right.project((1, 0, -1), size)
    np.testing.assert_allclose(shift, (2 * math.degrees(math.asin(0.1 / 3)), 0), atol=1e-9)


def test_colmap_files(tmp_path):
    """Cameras come back from COLMAP's text files, whose first pixel's center is (0.5, 0.5)."""
    cameras = [sv.Camera.from_opencv(K, R, SHIFT, SIZE, terms) for terms in ((), BROWN["four"], BROWN["rational"])]
    cameras.append(sv.Camera.from_opencv(FISHEYE_K, R, SHIFT, SIZE, KANNALA["wide"], projection="fisheye"))
    names = [f"a view {number}.png" for number in range(4)]
    sv.save_colmap(tmp_path, cameras, SIZE, names)
    models = [line.split()[1] for line in (tmp_path / "cameras.txt").read_text().splitlines()[1:]]
    assert models == ["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]
    found = sv.load_colmap(tmp_path)
    assert [(image.name, image.size) for image in found] == [(name, SIZE) for name in names]
    for camera, image in zip(cameras, found, strict=True):
        pixels = random_pixels(100)
        for one, other in zip(camera.rays(pixels, SIZE), image.camera.rays(pixels, SIZE), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)
    with pytest.raises(SolariError, match="no model for this stereographic camera"):
        sv.save_colmap(tmp_path, [sv.Camera(projection="stereographic")], SIZE, ["a"])


@pytest.mark.parametrize(
    ("cameras", "images", "message"),
    [
        ("1 SIMPLE_RADIAL 640 480 500 320.5 240.5 -0.1", "1 1 0 0 0 0 0 0 1 a.png\n", ""),
        ("1 FOV 640 480 1 2", "1 1 0 0 0 0 0 0 1 a.png\n", r"cameras.txt, line 1: the camera model 'FOV' isn't one of"),
        ("1 OPENCV 640 480 1 2", "1 1 0 0 0 0 0 0 1 a.png\n", "the model OPENCV has a size and 8 parameters"),
        ("1 PINHOLE 640 480 500 -1 320 240", "1 1 0 0 0 0 0 0 1 a.png\n", "line 1: Camera.from_opencv: K is"),
        ("2 PINHOLE 640 480 500 500 320 240", "1 1 0 0 0 0 0 0 1 a.png\n", "images.txt, line 1: there is no camera 1"),
        ("", "1 1 0 x 0 0 0 0 1 a.png\n", "an image is IMAGE_ID QW"),
    ],
)
def test_colmap_files_by_hand(tmp_path, cameras, images, message):
    (tmp_path / "cameras.txt").write_text(cameras)
    (tmp_path / "images.txt").write_text(images)
    if message:
        with pytest.raises(SolariError, match=message):
            sv.load_colmap(tmp_path)
    else:
        (image,) = sv.load_colmap(tmp_path)
        np.testing.assert_allclose(image.camera.intrinsics(SIZE), [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
        assert image.camera.distortion.tolist() == [-0.1, 0, 0, 0, 0, 0, 0, 0]


def test_colmap_reads_the_files(tmp_path):
    """COLMAP itself, by its package, projects points where the cameras do; its first pixel's center is (0.5, 0.5)."""
    pycolmap = pytest.importorskip("pycolmap")
    cameras = [sv.Camera.from_opencv(K, R, SHIFT, SIZE, terms) for terms in ((), BROWN["four"], BROWN["rational"])]
    cameras.append(sv.Camera.from_opencv(FISHEYE_K, R, SHIFT, SIZE, KANNALA["wide"], projection="fisheye"))
    sv.save_colmap(tmp_path, cameras, SIZE, [f"{number}.png" for number in range(4)])
    model = pycolmap.Reconstruction(str(tmp_path))
    assert len(model.images) == 4
    for image in model.images.values():
        camera = cameras[int(image.name[0])]
        origins, directions = camera.rays(random_pixels(50), SIZE)
        points = (origins + 4 * directions)[directions @ R[2] > 0.1]  # of a fisheye, COLMAP takes what is before it
        assert len(points) > 25
        found = np.array([image.project_point(point) for point in points])
        np.testing.assert_allclose(found - 0.5, camera.project(points, SIZE), atol=1e-4)
