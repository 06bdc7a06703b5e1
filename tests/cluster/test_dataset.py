"""Data sets: the same files whoever renders them, cameras as transforms.json says, and taking up again."""

from __future__ import annotations

import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.cluster.dataset import cameras_for

OPTIONS = ["--size", "24x16", "--samples", "2", "--seed", "3", "--aov", "depth,instance_id"]


@pytest.fixture
def make(any_device, tmp_path, capsys):
    """Run `solari-vk dataset`; returns the exit code, its stderr and the folder."""

    def run(*arguments, name="views", source="builtin:cornell_box"):
        folder = tmp_path / name
        code = main(["dataset", source, *OPTIONS, *map(str, arguments), "-o", str(folder)])
        return code, capsys.readouterr().err, folder

    return run


def contents(folder, but=()):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in but}


def test_workers_give_the_same_files(make, pool):
    """Streamed back, or written by the workers into a shared folder."""
    address = pool.client.scheduler.address
    code, said, alone = make("--views", 3, "--cameras", "random", name="alone")
    assert code == 0, said
    assert "3 of 3 pictures" in said
    for name, more in (("streamed", []), ("shared", ["--shared-folder"])):
        code, said, together = make("--views", 3, "--cameras", "random", "--cluster", address, *more, name=name)
        assert code == 0, said
        assert contents(together, ["views.jsonl"]) == contents(alone, ["views.jsonl"])
    names = {f"{number:05}{end}" for number in range(3) for end in (".png", ".depth.npy", ".instance_id.npy")}
    assert contents(alone).keys() == names | {"views.jsonl", "transforms.json"}


def test_the_example_loads_the_views(make):
    """Depth along its rays, which are those of transforms.json, gives the positions that the renderer gives."""
    code, said, folder = make("--views", 3, "--cameras", "random", "--aov", "depth,position")
    assert code == 0, said
    example = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs/examples/load_dataset.py"))
    views = example["Views"](folder)
    assert len(views) == 3
    for number in range(3):
        view = views[number]
        assert view["rgb"].shape == (16, 24, 3)
        assert np.isfinite(view["depth"]).mean() > 0.2
        there = np.isfinite(view["depth"])
        points = view["origin"] + view["depth"][there, None] * view["direction"][there]
        np.testing.assert_allclose(points, view["position"][there], atol=1e-4)
    transforms = json.loads((folder / "transforms.json").read_text())
    for frame in transforms["frames"]:
        assert math.isclose(2 * math.atan(transforms["w"] / 2 / frame["fl_x"]), frame["camera_angle_x"])
    assert len({str(frame["transform_matrix"]) for frame in transforms["frames"]}) == 3


def test_a_stopped_run_goes_on(make):
    """Files that are there with their content stay; one that was changed, and new views, are rendered."""
    _, _, folder = make("--views", 2, "--cameras", "random")
    whole = contents(folder)
    times = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    damaged = folder / "00001.depth.npy"
    damaged.write_bytes(b"x")
    (folder / "views.jsonl").open("a").write('{"task": "cut o')
    code, said, _ = make("--views", 3, "--cameras", "random")
    assert code == 0, said
    now = contents(folder)
    assert all(now[name] == data for name, data in whole.items() if name[0] == "0")
    assert "00002.png" in now
    assert (folder / "00000.png").stat().st_mtime_ns == times["00000.png"]
    assert (folder / "00001.png").stat().st_mtime_ns > times["00001.png"]
    code, said, _ = make("--views", 3, "--cameras", "random")
    assert code == 0
    assert contents(folder) == now


def test_a_folder_of_other_pictures_is_refused(make):
    _, _, folder = make("--views", 1)
    before = contents(folder)
    code, said, _ = make("--views", 1, "--max-bounces", 2)
    assert code == 2
    assert "another style" in said
    code, said, _ = make("--views", 1, source="builtin:closed_box")
    assert code == 2
    assert "another scene" in said
    code, said, _ = make("--views", 2, "--camera", '{"position": [1, 1, 4], "target": [1, 1, 0]}')
    assert code == 2
    assert "00000.png: is there already, with another camera" in said
    assert contents(folder) == before


def test_random_views_can_be_made_longer_with_one_exposure(make, monkeypatch):
    """Few views are metered as many: by the first places of the seed."""
    monkeypatch.setattr("solari_vk.cluster.tasks.METERED_SIDE", 8)
    monkeypatch.setattr("solari_vk.cluster.tasks.METERED_SAMPLES", 1)
    options = "--cameras", "random", "--exposure", "auto"
    code, said, folder = make("--views", 1, *options)
    assert code == 0, said
    first = (folder / "00000.png").read_bytes()
    code, said, _ = make("--views", 2, *options)
    assert code == 0, said
    assert "2 of 2 pictures" in said
    assert (folder / "00000.png").read_bytes() == first


def test_cameras_of_files(tmp_path):
    scene = sv.builtin("cornell_box")
    poses = [{"position": [1, 1, 5 + n], "target": [1, 1, 0], "vertical_fov_degrees": 40} for n in range(2)]
    path = tmp_path / "poses.json"
    path.write_text(json.dumps(poses))
    cameras = cameras_for(str(path), scene, scene.camera, None, 1.5, 0)
    assert [camera.transform[2, 3] for camera in cameras] == [5, 6]
    for given, words in (
        ("[]", "a JSON list of poses"), ("{", "JSON file"), ('{"frames": [{}]}', "lacks a field"),
        ('[{"position": 1}]', "pose 0"),
    ):  # fmt: skip
        path.write_text(given)
        with pytest.raises(sv.SolariError, match=words):
            cameras_for(str(path), scene, scene.camera, None, 1.5, 0)
    path.write_text(json.dumps(poses))
    with pytest.raises(sv.SolariError, match="has 2 poses"):
        cameras_for(str(path), scene, scene.camera, 3, 1.5, 0)
    with pytest.raises(sv.SolariError, match="--views"):
        cameras_for("orbit", scene, scene.camera, None, 1.5, 0)


def test_poses_of_the_original_nerf(tmp_path):
    """Its files have the horizontal field of view alone, and pictures may have any size."""
    scene = sv.builtin("cornell_box")
    path = tmp_path / "transforms.json"
    frame = {"transform_matrix": np.eye(4).tolist()}
    for lens, aspect, slope in (
        ({"camera_angle_x": 1.0}, 1.0, math.tan(0.5)), ({"camera_angle_x": 1.0}, 2.0, math.tan(0.5) / 2),
        ({"camera_angle_x": 1.0, "w": 30, "h": 10}, 1.0, math.tan(0.5) / 3),
        ({"fl_x": 20, "w": 30, "h": 10}, 1.0, 0.25),
        ({"fl_x": 20, "fl_y": 10, "camera_angle_x": 1.0, "w": 30, "h": 10}, 1.0, 0.5),
    ):  # fmt: skip
        path.write_text(json.dumps(lens | {"frames": [frame]}))
        (camera,) = cameras_for(str(path), scene, scene.camera, None, aspect, 0)
        assert math.isclose(math.tan(camera.vertical_fov / 2), slope)


def test_a_time_limit(make):
    """What is missing is in the exit code."""
    for limit in ("-1", "nan", "0"):
        code, said, folder = make("--views", 1, "--time-limit", limit)
        assert code == 2
        assert f"--time-limit {limit}: must be more than 0 seconds" in said
        assert not folder.exists()
    code, said, _ = make("--views", 3, "--time-limit", "1e-9")
    assert "of 3 pictures" in said
    assert code == 1
    assert make("--views", 3)[0] == 0


def test_transforms_are_poses_too(make, tmp_path):
    code, said, folder = make("--views", 2)
    assert code == 0, said
    code, said, again = make("--cameras", folder / "transforms.json", name="again")
    assert code == 0, said
    pictures = ["00000.png", "00001.png"]
    first, second = (
        [np.asarray(Image.open(place / name), np.float64) for name in pictures] for place in (folder, again)
    )
    np.testing.assert_allclose(first, second, atol=2)  # the field of view goes through pixels


def test_random_cameras_see_the_scene():
    """All of an object; or, in a room, from inside it."""
    room = sv.builtin("closed_box")
    low, high = room.bounds
    for camera in cameras_for("random", room, room.camera, 16, 1.5, 5):
        assert (camera.transform[:3, 3] > low).all()
        assert (camera.transform[:3, 3] < high).all()
    few, many = (cameras_for("random", room, room.camera, count, 1.5, 5) for count in (2, 4))
    assert all(np.array_equal(a.transform, b.transform) for a, b in zip(few, many, strict=False))
    others = cameras_for("random", room, room.camera, 2, 1.5, 6)
    assert not np.array_equal(few[0].transform, others[0].transform)


@pytest.mark.slow
def test_realtime_views_have_motion_and_errors(make):
    """Motion along an orbit is that between its views; a random view stands still."""
    options = ["--mode", "realtime", "--views", 3, "--warm-up", 1, "--average", 1, "--aov", "guides_motion,error"]
    code, said, around = make(*options, "--cameras", "orbit", name="around")
    assert code == 0, said
    code, said, still = make(*options, "--cameras", "random", name="still")
    assert code == 0, said
    moved, stood = (
        [np.abs(np.load(folder / f"{number:05}.guides_motion.npy")).max() for number in range(3)]
        for folder in (around, still)
    )
    assert min(moved[1:]) > 0.01
    assert max(stood) < 0.5 / 16  # less than half a pixel: jitter
    assert all(np.isfinite(np.load(around / f"{number:05}.error.npy")).all() for number in range(3))
    code, said, _ = make("--mode", "realtime", "--views", 1, "--denoise", name="wrong")
    assert code == 2
    assert "--settings denoise=on" in said
