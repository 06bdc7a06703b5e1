"""Camera paths and the movies that are made of them."""

from __future__ import annotations

import json
import math
import stat
import sys

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.output.animation import load_path, orbit
from solari_vk.output.movie import check_encoder, write_movie

CAMERA = sv.Camera.look_at((1, 2, 5), (1, 1, 0), vertical_fov=0.7, near=0.02, ev100=3.0)


def position(camera):
    return camera.transform[:3, 3]


def angle_between(a, b):
    cosine = (np.trace(a.transform[:3, :3].T @ b.transform[:3, :3]) - 1) / 2
    return math.degrees(math.acos(np.clip(cosine, -1, 1)))


# ---- orbits -----------------------------------------------------------------------------------------


def test_an_orbit_goes_around_its_center():
    center = np.array((1.0, 1.0, 0.0))
    cameras = orbit(CAMERA, center, 12)
    np.testing.assert_allclose(cameras[0].transform, CAMERA.transform, atol=1e-12)
    in_picture = (center - position(CAMERA)) @ CAMERA.transform[:3, :3]
    for before, after in zip(cameras, [*cameras[1:], cameras[0]], strict=True):
        assert angle_between(before, after) == pytest.approx(30)
        assert position(after)[1] == pytest.approx(2)
        np.testing.assert_allclose((center - position(after)) @ after.transform[:3, :3], in_picture, atol=1e-12)
        assert (after.vertical_fov, after.near, after.ev100) == (CAMERA.vertical_fov, CAMERA.near, CAMERA.ev100)


def test_a_sweep_returns_and_stays_within_its_angle():
    cameras = orbit(CAMERA, (1, 1, 0), 8, 30)
    angles = [angle_between(CAMERA, camera) for camera in cameras]
    assert max(angles) == pytest.approx(15)
    np.testing.assert_allclose([angles[0], angles[4]], 0, atol=1e-4)
    assert angle_between(cameras[2], cameras[6]) == pytest.approx(30)


# ---- paths ------------------------------------------------------------------------------------------


@pytest.fixture
def path(tmp_path):
    """path(poses, fps=.., count=..) returns the cameras along a file of these poses."""

    def load(poses, **options):
        file = tmp_path / "path.json"
        file.write_text(poses if isinstance(poses, str) else json.dumps(poses))
        return load_path(file, CAMERA, **{"fps": 10, **options})

    return load


POSES = [
    {"position": [0, 0, 5], "target": [0, 0, 0], "time": 0},
    {"position": [4, 1, 3], "target": [0, 0, 0], "time": 2, "vertical_fov_degrees": 60, "ev100": 5},
    {"position": [5, 0, 0], "target": [0, 1, 0], "time": 3},
]


def test_a_path_goes_through_its_poses(path):
    cameras = path(POSES)
    assert len(cameras) == 31
    for pose, index in zip(POSES, (0, 20, 30), strict=True):
        known = {key: value for key, value in pose.items() if key != "time"}
        expected = sv.Camera.from_pose({"vertical_fov_degrees": math.degrees(0.7), "ev100": 3.0} | known)
        np.testing.assert_allclose(cameras[index].transform, expected.transform, atol=1e-9)
        assert cameras[index].vertical_fov == pytest.approx(expected.vertical_fov)
        assert cameras[index].ev100 == pytest.approx(expected.ev100)
        assert cameras[index].near == CAMERA.near


def test_a_path_is_smooth(path):
    """The speed changes gradually and is never zero, also at the poses, and orientations are rotations."""
    cameras = path(POSES, fps=200)
    steps = np.diff([position(camera) for camera in cameras], axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 0.03 * np.abs(steps).max()
    speeds = np.linalg.norm(steps, axis=1)
    assert speeds.min() > 0.3 * speeds.max(), "the camera stops"
    axes = np.array([camera.transform[:3, :3] for camera in cameras])
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)
    assert max(angle_between(a, b) for a, b in zip(cameras[::20], cameras[20::20], strict=False)) < 8


def test_times_of_any_kind(path):
    """Interpolated transforms are affine whatever rounding does to their last row."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        times = np.cumsum(rng.uniform(0.1, 1, 4)).tolist()
        poses = [{"position": [x, 1, -2], "target": [1, 1, 1], "time": x} for x in times]
        assert all(camera.transform[3].tolist() == [0, 0, 0, 1] for camera in path(poses, fps=24))


def test_poses_without_times_are_a_second_apart_and_count_divides_the_path_evenly(path):
    poses = [{key: value for key, value in pose.items() if key != "time"} for pose in POSES]
    assert [len(path(poses, **options)) for options in ({}, {"count": 3}, {"count": 1})] == [21, 3, 1]
    positions = [position(camera) for camera in path(poses, count=3)]
    np.testing.assert_allclose(positions, [pose["position"] for pose in poses], atol=1e-9)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_scales_of_poses_are_left_out(path):
    """Also one whose square is too small for floats."""
    turned = sv.Camera.look_at((4, 1, 3), (0, 0, 0)).transform
    poses = [{"transform": (matrix @ np.diag([1e-200, 1, 1, 1])).tolist()} for matrix in (np.eye(4), turned)]
    first, last = path(poses, count=2)
    np.testing.assert_allclose([first.transform, last.transform], [np.eye(4), turned], atol=1e-12)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ("{broken", "JSON"),
        ({"position": [0, 0, 1]}, "list"),
        ([POSES[0]], "two poses"),
        ([POSES[0], 3], "two poses"),
        ([POSES[0], {"position": [0, 0, 1], "target": [0, 0, 0]}], "1 of 2"),
        *(
            [[POSES[0], POSES[2] | {"time": time}], words]
            for time, words in (
                ("late", "number"),
                (10**400, "number"),
                (0, "increase"),
                (float("nan"), "finite"),
                (1e9, "100,000"),
                (1e308, "within 1e"),
                (1e-320, "or more"),
            )
        ),
        ([pose | {"ev100": ev100} for pose, ev100 in zip(POSES, (-100, 100, 100), strict=True)], "the curve between"),
        ([POSES[0], POSES[2] | {"zoom": 3}], "pose 1.*zoom"),
        ([POSES[0], {"position": [0, 0, 1], "time": 1}], "pose 1.*target"),
        ([POSES[0], {"position": [0, 0, 5], "target": [0, 0, 9], "time": 1}], "0 and 1"),
    ],
)
def test_files_that_are_no_path(path, poses, words):
    with pytest.raises(sv.SolariError, match=rf"path\.json.*{words}"):
        path(poses)


def test_a_missing_path(tmp_path):
    with pytest.raises(sv.SolariError, match=r"none\.json"):
        load_path(tmp_path / "none.json", CAMERA, fps=24)


# ---- movies -----------------------------------------------------------------------------------------


@pytest.fixture
def pictures(tmp_path):
    files = [tmp_path / f"{index}.png" for index in range(3)]
    for index, file in enumerate(files):
        Image.new("RGB", (7, 5), (80 * index, 10, 200 - 60 * index)).save(file)
    return files


def test_a_gif_holds_the_pictures(pictures, tmp_path):
    write_movie(tmp_path / "a.gif", pictures, 20)
    with Image.open(tmp_path / "a.gif") as movie:
        assert (movie.n_frames, movie.info["duration"], movie.info["loop"]) == (3, 50, 0)
        for index, picture in enumerate(pictures):
            movie.seek(index)
            np.testing.assert_allclose(np.asarray(movie.convert("RGB")), np.asarray(Image.open(picture)), atol=2)


def test_an_mp4_holds_the_pictures(pictures, tmp_path, monkeypatch):
    """Written without an ffmpeg on the PATH and decoded again. Sides become even; the colors survive the codec."""
    import imageio_ffmpeg

    monkeypatch.setenv("PATH", "")
    write_movie(tmp_path / "a.mp4", pictures, 20)
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    described = next(frames)
    assert (described["size"], described["fps"]) == ((8, 6), 20)
    decoded = [np.frombuffer(frame, np.uint8).reshape(6, 8, 3) for frame in frames]
    assert len(decoded) == len(pictures)
    for frame, picture in zip(decoded, pictures, strict=True):
        np.testing.assert_allclose(frame[2, 3], np.asarray(Image.open(picture))[2, 3], atol=12)


def test_an_mp4_without_ffmpeg_names_the_command_that_installs_it(pictures, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for attempt in (check_encoder, lambda path: write_movie(path, pictures, 20)):
        with pytest.raises(sv.SolariError, match=r"a\.mp4: an \.mp4 needs ffmpeg.*pip install 'solari-vk\[video\]'"):
            attempt(tmp_path / "a.mp4")
    check_encoder(tmp_path / "a.gif")
    assert not (tmp_path / "a.mp4").exists()


@pytest.mark.parametrize(
    ("script", "error"),
    [
        ('echo "$@" > "$(dirname "$0")/arguments"; for last; do :; done; cat > "$last"', None),
        ("echo no such encoder >&2; exit 1", r"a\.mp4: can't be written: ffmpeg: no such encoder"),
    ],
)
def test_the_ffmpeg_on_the_path(pictures, tmp_path, monkeypatch, script, error):
    """A shell script in its place shows what it is given, or fails."""
    ffmpeg, movie = tmp_path / "bin/ffmpeg", tmp_path / "a.mp4"
    ffmpeg.parent.mkdir()
    ffmpeg.write_text(f"#!/bin/sh\n{script}\n")
    ffmpeg.chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", str(ffmpeg.parent), prepend=":")
    if error:
        with pytest.raises(sv.SolariError, match=error):
            write_movie(movie, pictures, 30)
        assert sorted(file.name for file in tmp_path.iterdir()) == ["0.png", "1.png", "2.png", "bin"]
    else:
        write_movie(movie, pictures, 30)
        assert movie.read_bytes() == b"".join(picture.read_bytes() for picture in pictures)
        assert "-framerate 30 " in (ffmpeg.parent / "arguments").read_text()
