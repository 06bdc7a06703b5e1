"""Data sets and movies: the same files whoever renders them, cameras as transforms.json says, and taking up again."""

from __future__ import annotations

import json
import math
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.data.cluster import Style, View, blocks
from solari_vk.data.datasets.dataset import cameras_for
from solari_vk.output.animation import orbit
from solari_vk.renderers.cluster.device_session import DeviceSession, pack

OPTIONS = ["--size", "24x16", "--samples", "2", "--seed", "3", "--aov", "depth,instance_id,position"]
THREE = ("--views", 3, "--cameras", "random")


def dataset(folder, *arguments, source="builtin:cornell_box"):
    return main(["dataset", source, *OPTIONS, *map(str, arguments), "-o", str(folder)])


@pytest.fixture(scope="module")
def views(any_device, tmp_path_factory):
    """A folder of three views, rendered in this process."""
    folder = tmp_path_factory.mktemp("rendered") / "views"
    assert dataset(folder, *THREE) == 0
    return folder


@pytest.fixture
def copied(views, tmp_path):
    return shutil.copytree(views, tmp_path / "copied")


@pytest.fixture
def make(lent_device, tmp_path, capsys):
    """make(..., name=, code=): run `solari-vk dataset` with this exit code; returns its stderr and the folder."""

    def run(*arguments, name="views", code=0, **options):
        folder = tmp_path / name
        exit_code, said = dataset(folder, *arguments, **options), capsys.readouterr().err
        assert exit_code == code, said
        return said, folder

    return run


def contents(folder, but=()):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in but}


def test_annotations(make, copied, tmp_path):
    """The data set goes on from where it was, and pycocotools and the numbers in instance_id agree with its files."""
    coco_tools = pytest.importorskip("pycocotools.coco")
    (tmp_path / "classes.json").write_text('{"*block": "block", "lamp": "a lamp"}')
    more = "--labels", tmp_path / "classes.json", "--annotations", "coco,yolo"
    said, folder = make(*THREE, *more, name="copied")
    assert ": 3 of 3 pictures, 0" in said
    table = {row["id"]: row for row in json.loads((folder / "instances.json").read_text())["instances"]}
    coco = coco_tools.COCO(folder / "annotations.json")
    assert [category["name"] for category in coco.loadCats(coco.getCatIds())] == ["a lamp", "block"]
    seen = 0
    for image in coco.loadImgs(coco.getImgIds()):
        ids, position = (
            np.load(folder / image["file_name"].replace("png", f"{name}.npy")) for name in ("instance_id", "position")
        )
        lines = (folder / image["file_name"].replace("png", "txt")).read_text().splitlines()
        found = coco.loadAnns(coco.getAnnIds(image["id"]))
        assert len(lines) == len(found) == len({n for n in np.unique(ids) if n in table and table[n]["label"]})
        for one, line in zip(found, lines, strict=True):
            mask, row = coco.annToMask(one) > 0, table[one["instance_id"]]
            assert np.array_equal(mask, ids == one["instance_id"])
            x, y, width, height = one["bbox"]
            assert np.array_equal(np.argwhere(mask).min(0), [y, x])
            assert np.array_equal(np.argwhere(mask).max(0), [y + height - 1, x + width - 1])
            category, *box = map(float, line.split())
            assert coco.cats[one["category_id"]]["name"] == row["label"] == ["a lamp", "block"][int(category)]
            center = x + width / 2, y + height / 2
            assert np.multiply(box, (24, 16, 24, 16)) == pytest.approx((*center, width, height), abs=1e-4)
            local = np.c_[position[mask], np.ones(mask.sum())] @ np.linalg.inv(row["transform"]).T
            assert np.all(
                np.abs(local[:, :3] - row["lowest"] - np.divide(row["size"], 2)) <= np.divide(row["size"], 2) + 1e-4
            )
            seen += one["area"]
    assert seen > 50


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--annotations", "coco"), "no instance has a label"),
        (("--annotations", "voc"), "--annotations voc: take some of coco, yolo, objects, bop"),
        (("--annotations", "coco", "--format", "exr"), "give --format png, jpg or npy"),
        (("--labels", "{}/chairs.json"), "chairs.json: no instance is named 'Chair*'; names are "),
        (("--labels", "{}/list.json"), "list.json: give a class for each pattern"),
        (("--labels", "{}/none.json"), "none.json"),
    ],
)
def test_labels_that_fit_nothing(make, tmp_path, arguments, message):
    (tmp_path / "chairs.json").write_text('{"lamp": "lamp", "Chair*": "chair"}')
    (tmp_path / "list.json").write_text('["lamp"]')
    said, _ = make(*THREE, *(text.format(tmp_path) for text in arguments), code=2)
    assert message in said


def test_labels_for_nothing_are_refused(tmp_path, capsys):
    (tmp_path / "classes.json").write_text('{"lamp": "lamp"}')
    output = "--labels", str(tmp_path / "classes.json"), "-o", str(tmp_path / "views")
    assert main(["dataset", "builtin:cornell_box", "--views", "1", *output]) == 2
    assert "--labels: are part of --annotations and --aov instance_id" in capsys.readouterr().err


def test_workers_give_the_same_files(make, views, pool):
    """Streamed back, or written by the workers into a shared folder."""
    for name, more in (("streamed", []), ("shared", ["--shared-folder"])):
        said, together = make(*THREE, "--cluster", pool.client.scheduler.address, *more, name=name)
        assert "3 of 3 pictures" in said
        assert contents(together, ["views.jsonl"]) == contents(views, ["views.jsonl"])
    ends = (".png", ".depth.npy", ".instance_id.npy", ".position.npy")
    names = {f"{number:05}{end}" for number in range(3) for end in ends}
    assert contents(views).keys() == names | {"views.jsonl", "transforms.json", "instances.json"}


def test_the_example_loads_the_views(views):
    """Depth along its rays, which are those of transforms.json, gives the positions that the renderer gives."""
    example = runpy.run_path(str(Path(__file__).resolve().parents[3] / "docs/examples/load_dataset.py"))
    loaded = example["Views"](views)
    assert len(loaded) == 3
    for view in (loaded[number] for number in range(3)):
        assert view["rgb"].shape == (16, 24, 3)
        there = np.isfinite(view["depth"])
        assert there.mean() > 0.2
        points = view["origin"] + view["depth"][there, None] * view["direction"][there]
        np.testing.assert_allclose(points, view["position"][there], atol=1e-4)
    transforms = json.loads((views / "transforms.json").read_text())
    for frame in transforms["frames"]:
        assert math.isclose(2 * math.atan(transforms["w"] / 2 / frame["fl_x"]), frame["camera_angle_x"])
    assert len({str(frame["transform_matrix"]) for frame in transforms["frames"]}) == 3


def test_transforms_are_poses_too(make, views):
    _, again = make("--cameras", views / "transforms.json", "--colmap")
    frames = json.loads((views / "transforms.json").read_text())["frames"]
    for image, frame in zip(sv.load_colmap(again / "sparse" / "0"), frames, strict=True):
        assert image.name == frame["file_path"]
        np.testing.assert_allclose(image.camera.transform, frame["transform_matrix"], atol=1e-9)
        assert image.camera.intrinsics(image.size)[1, 1] == pytest.approx(frame["fl_y"])
    first, second = (
        [np.asarray(Image.open(folder / f"0000{n}.png"), np.float64) for n in range(3)] for folder in (views, again)
    )
    np.testing.assert_allclose(first, second, atol=2)  # the field of view goes through pixels


def test_poses_keep_their_exposures(make, views, tmp_path):
    content = json.loads((views / "transforms.json").read_text())
    content["frames"][1]["ev100"] += 3
    (tmp_path / "poses.json").write_text(json.dumps(content))
    _, again = make("--cameras", tmp_path / "poses.json")
    before, after = ([camera.ev100 for camera in sv.Views(folder, ["rgb"]).cameras] for folder in (views, again))
    np.testing.assert_allclose(np.subtract(after, before), [0, 3, 0])
    _, fixed = make("--cameras", tmp_path / "poses.json", "--exposure", "2", name="fixed")
    assert [camera.ev100 for camera in sv.Views(fixed, ["rgb"]).cameras] == [2, 2, 2]


def test_cameras_that_colmap_lacks_are_refused_first(make, tmp_path):
    pose = {"position": [1, 1, 1], "target": [1, 1, 0], "projection": "equirectangular"}
    (tmp_path / "poses.json").write_text(json.dumps([pose]))
    said, folder = make("--cameras", tmp_path / "poses.json", "--colmap", code=2)
    assert "COLMAP has no model for this equirectangular camera" in said
    assert not any(folder.iterdir())


def test_a_stopped_run_goes_on(make, copied):
    """Files that are there with their content stay; one that was changed, and new views, are rendered."""
    whole = contents(copied)
    times = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    (copied / "00001.depth.npy").write_bytes(b"x")
    (copied / "views.jsonl").open("a").write('{"task": "cut o')
    make("--views", 4, "--cameras", "random", name=copied.name)
    now = contents(copied)
    assert all(now[name] == data for name, data in whole.items() if name[0] == "0")
    assert "00003.png" in now
    rendered = {name for name, time in times.items() if (copied / name).stat().st_mtime_ns > time}
    assert {name for name in rendered if name.endswith(".png")} == {"00001.png"}
    make("--views", 4, "--cameras", "random", name=copied.name)
    assert contents(copied) == now


def test_a_folder_of_other_pictures_is_refused(make, copied):
    before = contents(copied)
    for arguments, source, words in (
        ((*THREE, "--max-bounces", 2), "cornell_box", "another style"),
        (THREE, "closed_box", "another scene"),
        (("--views", 3), "cornell_box", "00000.png: is there already, with another camera"),
    ):
        said, _ = make(*arguments, name=copied.name, source=f"builtin:{source}", code=2)
        assert words in said
    assert contents(copied) == before


def test_random_views_can_be_made_longer_with_one_exposure(make, monkeypatch):
    """Few views are metered as many: by the first places of the seed."""
    monkeypatch.setattr("solari_vk.data.datasets.tasks.METERED_SIDE", 8)
    monkeypatch.setattr("solari_vk.data.datasets.tasks.METERED_SAMPLES", 1)
    options = "--cameras", "random", "--exposure", "auto"
    _, folder = make("--views", 1, *options)
    first = (folder / "00000.png").read_bytes()
    said, _ = make("--views", 2, *options)
    assert "2 of 2 pictures" in said
    assert (folder / "00000.png").read_bytes() == first


def poses(path, text, views=None, aspect=1.5):
    path.write_text(text)
    scene = sv.builtin("cornell_box")
    return cameras_for(str(path), scene, scene.camera, views, aspect, 0)


def test_views_of_poses_can_be_made_longer_with_a_given_exposure(make, tmp_path):
    """As the guide says; a measured one is that of all poses."""
    poses = [{"position": [0.6 + 0.2 * n, 1, -2.5], "target": [1, 0.7, 1]} for n in range(3)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    given = "--cameras", tmp_path / "poses.json", "--exposure", 3
    (_, short), (_, long) = (make(*given, "--views", count, name=f"{count}") for count in (1, 3))
    for path in short.glob("0*"):
        assert (long / path.name).read_bytes() == path.read_bytes()


def test_cameras_of_files(tmp_path):
    path = tmp_path / "poses.json"
    two = [{"position": [1, 1, 5 + n], "target": [1, 1, 0], "vertical_fov_degrees": 40} for n in range(2)]
    assert [camera.transform[2, 3] for camera in poses(path, json.dumps(two))] == [5, 6]
    for given, views, words in (
        ("[]", None, "a JSON list of poses"),
        ("{", None, "JSON file"),
        ('{"frames": [{}]}', None, "lacks a field"),
        ('[{"position": 1}]', None, "pose 0"),
        (json.dumps(two), 3, "has 2 poses"),
    ):
        with pytest.raises(sv.SolariError, match=words):
            poses(path, given, views)
    scene = sv.builtin("cornell_box")
    with pytest.raises(sv.SolariError, match="--views"):
        cameras_for("orbit", scene, scene.camera, None, 1.5, 0)


def test_poses_of_the_original_nerf(tmp_path):
    """Its files have the horizontal field of view alone, and pictures may have any size."""
    angle, size = {"camera_angle_x": 1.0}, {"w": 30, "h": 10}
    for lens, aspect, slope in (
        (angle, 1.0, math.tan(0.5)),
        (angle, 2.0, math.tan(0.5) / 2),
        (angle | size, 1.0, math.tan(0.5) / 3),
        ({"fl_x": 20} | size, 1.0, 0.25),
        ({"fl_x": 20, "fl_y": 10} | angle | size, 1.0, 0.5),
    ):
        frames = {"frames": [{"transform_matrix": np.eye(4).tolist()}]}
        (camera,) = poses(tmp_path / "transforms.json", json.dumps(lens | frames), aspect=aspect)
        assert math.isclose(math.tan(camera.vertical_fov / 2), slope)


def test_a_time_limit(make):
    """What is missing is in the exit code."""
    for limit in ("-1", "nan", "0"):
        said, folder = make("--views", 1, "--time-limit", limit, code=2)
        assert f"--time-limit {limit}: must be more than 0 seconds" in said
        assert not folder.exists()
    said, _ = make("--views", 2, "--time-limit", "1e-9", code=1)
    assert "of 2 pictures" in said
    make("--views", 2)


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
def test_realtime_views_have_motion_and_errors(make, tmp_path):
    """Motion along an orbit is that between its views; a random view stands still."""
    options = ["--mode", "realtime", "--warm-up", "1", "--average", "1", "--aov", "guides_motion,error"]
    options += ["--views", 3, "--cameras"]
    moved, stood = (
        [np.abs(np.load(folder / f"{number:05}.guides_motion.npy")).max() for number in range(3)]
        for _, folder in (make(*options, cameras, name=cameras) for cameras in ("orbit", "random"))
    )
    assert min(moved[1:]) > 0.01
    assert max(stood) < 0.5 / 16  # less than half a pixel: jitter
    errors = (tmp_path / "orbit").glob("*.error.npy")
    assert [bool(np.isfinite(np.load(path)).all()) for path in errors] == [True] * 3
    said, _ = make("--mode", "realtime", "--views", 1, "--denoise", name="wrong", code=2)
    assert "--settings denoise=on" in said


# ---- movies -----------------------------------------------------------------------------------------


def orbiting(count, frames=2, warm_up=3):
    scene = sv.builtin("cornell_box")
    cameras = orbit(scene.camera, scene.bounds.center, count, 20.0)
    style = Style((24, 16), seed=5, layers=("guides_motion",), settings=sv.Settings(), frames=frames, warm_up=warm_up)
    return scene, style, [View(f"{number}.npy", camera) for number, camera in enumerate(cameras)]


def test_blocks_begin_with_the_frames_before_them():
    _, style, views = orbiting(7)
    first, second, third = blocks(style, views, length=3)
    names = [[view.name[0] for view in task.before] for task in (first, second, third)]
    assert names == [["0", "0", "0"], ["1", "2", "2"], ["4", "5", "5"]]
    assert [[view.name[0] for view in task.views] for task in (first, second, third)] == [[*"012"], [*"345"], ["6"]]
    _, cold, _ = orbiting(7, warm_up=0)
    assert [[view.name[0] for view in task.before] for task in blocks(cold, views, length=3)] == [[], ["2"], ["5"]]


@pytest.mark.slow
def test_a_block_is_the_same_after_any_other(device):
    """On a session that rendered another block before, and on a fresh one. Where frames before a block are all that its
    light remembers, it shows the same as one long run."""
    scene, style, views = orbiting(6)
    key, data = pack(scene)
    results = []
    for order in ((0, 1), (1, 0)):
        session = DeviceSession(device)
        session.load_scene(key, data, None)
        tasks = blocks(style, views, length=3)
        files = {}
        for number in order:
            files |= tasks[number].perform(session)
        results.append({name: file.sha256 for name, file in files.items()})
        session.free_scene()
    assert results[0] == results[1]
    assert len(results[0]) == 12


@pytest.mark.slow
def test_the_command_renders_a_movie_with_workers(pool, tmp_path, capsys):
    """The pictures are those of one worker; the folder of pictures goes when the movie is there."""
    command = ["render", "builtin:cornell_box", "--size", "24x16", "--average", "1", "--warm-up", "2"]
    command += ["--animate", "orbit:20", "--frames", "26"]
    address = ["--cluster", pool.client.scheduler.address]
    path = tmp_path / "movie.gif"
    assert main([*command, *address, "-o", str(path)]) == 0, capsys.readouterr().err
    assert "26 of 26 pictures" in capsys.readouterr().err
    assert Image.open(path).n_frames == 26
    assert [entry.name for entry in tmp_path.iterdir()] == ["movie.gif"]
    for workers, name in ((address, "two"), (["--workers", "1"], "one")):
        (tmp_path / name).mkdir()
        assert main([*command, *workers, "-o", str(tmp_path / name / "p.npy")]) == 0, capsys.readouterr().err
    for number in range(26):
        assert np.array_equal(*(np.load(tmp_path / name / f"p.{number:04}.npy") for name in ("one", "two")))
    lines = [json.loads(line) for line in (tmp_path / "one" / "p.jsonl").read_text().splitlines()]
    assert len(lines) == 3  # what the pictures are made of, and two blocks
