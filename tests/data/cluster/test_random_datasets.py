"""Random data sets with labels in space: a picture alone is the same picture, and its labels are of its own scene."""

import json

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.data.annotate.keypoints import find_keypoints
from solari_vk.data.cli import annotations
from solari_vk.data.datasets.dataset import cameras_for

RECIPE = """
cameras: {roll: [-20, 20], vertical_fov: [0.6, 0.8]}
instances:
  "*block": {offset: [[-0.3, 0, -0.3], [0.3, 0, 0.3]], turn: [0, 360]}
  "tall block": {visible: {choose: [true, false]}}
materials:
  "*": {base_color: [[0.1, 0.1, 0.1], [1, 1, 1]]}
distractors: {count: [1, 3], size: [0.1, 0.2], within: [[0.4, 0.4, 0.4], [1.6, 1.6, 1.6]]}
"""
ALL = ("--annotations", "coco,yolo,objects,bop")


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recipe")
    (folder / "random.yaml").write_text(RECIPE)
    poses = [{"position": [0.6 + 0.2 * n, 1, -2.5], "target": [1, 0.7, 1]} for n in range(5)]
    (folder / "poses.json").write_text(json.dumps(poses))
    (folder / "classes.json").write_text('{"*block": "block", "lamp": "lamp"}')
    return folder


def run(recipe, folder, *more, code=0):
    options = ["--size", "40x32", "--samples", "2", "--aov", "position", "--randomize", str(recipe / "random.yaml")]
    labels = ["--labels", str(recipe / "classes.json"), "--cameras", str(recipe / "poses.json")]
    assert main(["dataset", "builtin:cornell_box", *options, *labels, *map(str, more), "-o", str(folder)]) == code
    return folder


@pytest.fixture(scope="module")
def views(any_device, recipe, tmp_path_factory):
    return run(recipe, tmp_path_factory.mktemp("rendered") / "views", "--views", 5, *ALL, "--shards", 2)


def scene_of(recipe, number):
    """The scene of a view, to look at."""
    scene = sv.builtin("cornell_box")
    randomizer = sv.Randomizer.load(recipe / "random.yaml", 0)
    randomizer.prepare(scene)
    return scene, randomizer.applied(scene, number)


def test_a_view_alone_is_the_same(recipe, views, tmp_path):
    """By its number: a folder whose first views are there renders the others; one more view leaves the others alone."""
    folder = tmp_path / "views"
    run(recipe, folder, "--views", 5, *ALL)
    for path in views.glob("0*"):
        assert (folder / path.name).read_bytes() == path.read_bytes()
    (folder / "00003.png").unlink()
    run(recipe, folder, "--views", 5, *ALL)
    assert (folder / "00003.png").read_bytes() == (views / "00003.png").read_bytes()
    pictures = {(views / f"{number:05}.png").read_bytes() for number in range(5)}
    assert len(pictures) == 5


def test_other_recipes_are_refused(recipe, views, tmp_path, capsys):
    other = tmp_path / "other"
    other.mkdir()
    (other / "random.yaml").write_text(RECIPE.replace("20", "21"))
    for name in ("classes.json", "poses.json"):
        (other / name).write_text((recipe / name).read_text())
    run(other, views, "--views", 5, *ALL, code=2)
    assert "another style" in capsys.readouterr().err
    (other / "random.yaml").write_text("instance: {}")
    run(other, tmp_path / "new", "--views", 1, code=2)
    assert "random.yaml: there is no key 'instance'; did you mean 'instances'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_boxes_in_space_are_of_the_views_own_scene(recipe, views):
    """The positions that a pixel shows are within the box of its instance, in its pose in this picture."""
    transforms = json.loads((views / "transforms.json").read_text())
    seen, hidden = 0, set()
    for number, frame in enumerate(transforms["frames"]):
        ids, position = (np.load(views / f"{number:05}.{name}.npy") for name in ("instance_id", "position"))
        world = np.array(frame["transform_matrix"])
        rows = json.loads((views / f"{number:05}.objects.json").read_text())
        scene, applied = scene_of(recipe, number)
        with applied:
            visible = scene.instances["tall block"].visible
        assert ("tall block" in {row["name"] for row in rows}) <= visible
        hidden.add(visible)
        for row in rows:
            mask = ids == row["id"]
            points = (position[mask] - world[:3, 3]) @ (world[:3, :3] @ np.diag((1, -1, -1)))
            inside = (points - row["center"]) @ np.array(row["rotation"])
            assert (np.abs(inside) <= np.array(row["size"]) / 2 + 1e-3).all()
            assert 0 <= row["visible_fraction"] <= 1
            if mask.any():
                rows_of, columns = np.nonzero(mask)
                assert row["box"] == [columns.min(), rows_of.min(), np.ptp(columns) + 1, np.ptp(rows_of) + 1]
            seen += mask.sum()
    assert seen > 300
    assert hidden == {True, False}


def test_bop_files_fit_the_pictures(views):
    """Depth unprojected by cam_K, then moved into the models' frames, is within their boxes."""
    bop, scene = views / "bop", views / "bop" / "train" / "000000"
    cameras, poses, infos = (
        json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")
    )
    models, names = (json.loads((bop / name).read_text()) for name in ("models/models_info.json", "objects.json"))
    assert {row["label"] for row in names.values()} == {"block", "lamp"}
    seen = 0
    for number in range(5):
        assert (scene / "rgb" / f"{number:06}.png").read_bytes() == (views / f"{number:05}.png").read_bytes()
        camera = cameras[str(number)]
        depth = np.asarray(Image.open(scene / "depth" / f"{number:06}.png"), float) * camera["depth_scale"]
        rows, columns = np.nonzero(depth)
        points = np.stack([columns, rows, np.ones(len(rows))]).T @ np.linalg.inv(np.reshape(camera["cam_K"], (3, 3))).T
        points *= depth[rows, columns, None]
        for index, (row, info) in enumerate(zip(poses[str(number)], infos[str(number)], strict=True)):
            whole, visible = (
                np.asarray(Image.open(scene / kind / f"{number:06}_{index:06}.png")) == 255
                for kind in ("mask", "mask_visib")
            )
            assert (whole >= visible).all()
            assert info["px_count_visib"] == visible.sum()
            assert info["px_count_all"] >= whole.sum()
            assert info["visib_fract"] == pytest.approx(visible.sum() / max(info["px_count_all"], 1))
            mine = (points[visible[rows, columns]] - row["cam_t_m2c"]) @ np.reshape(row["cam_R_m2c"], (3, 3))
            model = models[str(row["obj_id"])]
            assert (np.abs(mine) <= np.array([model[f"size_{axis}"] for axis in "xyz"]) / 2 + 1).all()
            seen += len(mine)
    assert seen > 300


def test_shards_hold_all(views):
    webdataset = pytest.importorskip("webdataset")
    paths = [str(path) for path in sorted((views / "shards").glob("*.tar"))]
    assert len(paths) == 3
    read = list(webdataset.WebDataset(paths, shardshuffle=False).decode("rgb8"))
    frames = json.loads((views / "transforms.json").read_text())["frames"]
    for number, (sample, frame) in enumerate(zip(read, frames, strict=True)):
        assert sample["__key__"] == f"{number:05}"
        assert np.array_equal(sample["depth.npy"], np.load(views / f"{number:05}.depth.npy"))
        assert np.array_equal(sample["png"], np.asarray(Image.open(views / f"{number:05}.png")))
        assert sample["json"]["transform_matrix"] == frame["transform_matrix"]
        assert sample["json"]["w"] == 40
        assert sample["objects.json"] == json.loads((views / f"{number:05}.objects.json").read_text())


def test_views_are_a_data_set_of_pytorch(views, recipe):
    """Samples are the files; depth along the cameras' rays leads to the positions that the renderer gives."""
    loaded = sv.Views(views)
    assert (len(loaded), loaded.size) == (5, (40, 32))
    assert loaded.names == ("rgb", "position", "instance_id", "depth")
    sample = loaded[1]
    assert np.array_equal(np.rint(sample["rgb"] * 255), np.asarray(Image.open(views / "00001.png")))
    there = np.isfinite(sample["depth"])
    v, u = np.nonzero(there)
    points = loaded.cameras[1].unproject(np.stack([u, v], -1), sample["depth"][there], loaded.size)
    np.testing.assert_allclose(points, sample["position"][there], atol=1e-3)
    assert loaded.objects(1) == json.loads((views / "00001.objects.json").read_text())
    assert [sorted(one) for one in sv.Views(views, ["rgb"])] == [["rgb"]] * 5
    with pytest.raises(sv.SolariError, match=r"samples have rgb, and no depth: .* Views\(folder, \['rgb', 'depth'\]\)"):
        sv.Views(views, ["rgb"])[0]["depth"]
    for wrong, words in (
        (lambda: sv.Views(views, ["dept"]), "views have no 'dept'; did you mean 'depth'"),
        (lambda: sv.Views(recipe), "there is no such file"),
    ):
        with pytest.raises(sv.SolariError, match=words):
            wrong()
    named = sv.Views(views, ["boxes", "labels", "masks", "instance_id"])
    coco = json.loads((views / "annotations.json").read_text())
    for number, thing in enumerate(named):
        rows = [one for one in coco["annotations"] if one["image_id"] == number + 1]
        assert thing["labels"].tolist() == [one["category_id"] for one in rows]
        for (left, top, right, bottom), mask, row in zip(thing["boxes"], thing["masks"], rows, strict=True):
            assert np.array_equal(mask, thing["instance_id"] == row["instance_id"])
            y, x = np.nonzero(mask)
            assert (left, top, right, bottom) == (x.min(), y.min(), x.max() + 1, y.max() + 1)
    assert named[0]["instance_id"].dtype == np.int32
    assert named[0]["instance_id"].min() == -1
    far = coco["annotations"][0] | {"bbox": [10**400, 0, 1, 1], "image_id": 1}
    for broken in ({"images": [], "annotations": []}, {"annotations": [far]}):
        (views / "annotations.json").write_text(json.dumps(coco | broken))
        with pytest.raises(sv.SolariError, match="lacks what"):
            sv.Views(views, ["boxes"])[0]
    data = pytest.importorskip("torch.utils.data")
    batches = list(data.DataLoader(sv.Views(views, ["rgb", "depth"]), batch_size=2))
    assert [tuple(batch["rgb"].shape) for batch in batches] == [(2, 32, 40, 3), (2, 32, 40, 3), (1, 32, 40, 3)]


def test_keypoints(recipe, tmp_path):
    """As COCO has them, read by its package: those of the views' own scenes, found by a ray tracer of their own."""
    coco_tools = pytest.importorskip("pycocotools.coco")
    named = {"first": 0, "last": 7, "far": [9, 9, 9]}
    (tmp_path / "points.json").write_text(json.dumps({"*block": named}))
    folder = run(recipe, tmp_path / "views", "--annotations", "coco,objects", "--keypoints", tmp_path / "points.json")
    coco = coco_tools.COCO(folder / "annotations.json")
    (block,) = coco.loadCats(coco.getCatIds(["block"]))
    assert block["keypoints"] == list(named)
    scene = sv.builtin("cornell_box")
    camera_of = sv.Views(folder).cameras
    states = set()
    randomizer = sv.Randomizer.load(recipe / "random.yaml", 0)
    randomizer.prepare(scene)
    with sv.Device() as device, sv.RayTracer(device, scene) as tracer:
        for number, image in enumerate(coco.loadImgs(coco.getImgIds())):
            with randomizer.applied(scene, number):
                expected = sv.keypoints(tracer, camera_of[number], (40, 32), {"*block": named})
            rows = {row["name"]: row for row in json.loads((folder / f"{number:05}.objects.json").read_text())}
            found = {one["instance_id"]: one for one in coco.loadAnns(coco.getAnnIds(image["id"]))}
            for instance, points in expected.items():
                row = rows.get(instance.name)
                if row is None:
                    continue
                for name, point in points.items():
                    assert row["keypoints"][name][2] == point.state
                    if point.state:
                        np.testing.assert_allclose(row["keypoints"][name][:2], point.pixel, atol=0.01)
                    states.add(point.state)
                if row["id"] in found:
                    one = found[row["id"]]
                    assert one["keypoints"][2::3] == [point.state for point in points.values()]
                    assert one["num_keypoints"] == sum(point.state > 0 for point in points.values())
    assert states == {0, 1, 2}


def test_wrong_keypoints(recipe, tmp_path, capsys, any_device):
    for text, more, words in (
        ('{"*block": {"a": 0}}', ("--annotations", "yolo"), "--keypoints: are part of --annotations coco or objects"),
        ('{"chair": {"a": 0}}', ("--annotations", "coco"), "keypoints: no instance is named 'chair'"),
        ('{"distractor*": {"a": 0}}', ("--annotations", "coco"), "keypoints: no instance is named 'distractor*'"),
        ('{"tall block": {"a": 0}}', ("--annotations", "coco"), "instances of the class 'block' have other keypoints"),
        ('{"*block": {"a": 99}}', ("--annotations", "coco"), "'a' of Instance 'short block': is three numbers, or a"),
    ):
        (tmp_path / "points.json").write_text(text)
        run(recipe, tmp_path / "views", *more, "--keypoints", tmp_path / "points.json", code=2)
        assert words in capsys.readouterr().err
    assert not any((tmp_path / "views").iterdir())  # refused before anything is rendered
    with pytest.raises(sv.SolariError, match="keypoints: a pattern of names is text, not 3"):
        find_keypoints(sv.builtin("cornell_box").instances[:], {3: {"a": 0}})


def test_ids_are_read_once(recipe, views, monkeypatch):
    counted = []
    read = annotations.read_npy
    monkeypatch.setattr(annotations, "read_npy", lambda path, who: counted.append(str(path)) or read(path, who))
    run(recipe, views, "--views", 5, *ALL)
    ids = [path for path in counted if "instance_id" in path]
    assert len(ids) == len(set(ids)) == 5
    assert (views / "classes.txt").exists()


def test_workers_give_the_same(recipe, views, pool, tmp_path):
    options = "--views", 5, *ALL
    together = run(recipe, tmp_path / "views", *options, "--cluster", pool.client.scheduler.address)
    for path in views.glob("0*"):
        assert (together / path.name).read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_realtime_views_are_random_too(recipe, tmp_path, any_device):
    options = ["--mode", "realtime", "--warm-up", 1, "--average", 1, "--annotations", "objects"]
    three, two = (run(recipe, tmp_path / str(count), "--views", count, *options) for count in (3, 2))
    for number in range(2):
        assert (two / f"{number:05}.png").read_bytes() == (three / f"{number:05}.png").read_bytes()


def test_objects_of_several_parts(tmp_path, any_device):
    """A chair of two primitives has one annotation of each kind."""
    scene = sv.Scene(sv.Environment((1, 1, 1)))
    for part, x in enumerate((-0.5, 0.5)):
        scene.add(sv.shapes.box(), name=f"chair/{part}", position=(x, 0.2 * part, 0), part_of="chair")
    scene.save(tmp_path / "chair.glb")
    (tmp_path / "classes.json").write_text('{"chair*": "chair"}')
    options = ["--views", "1", "--size", "32x24", "--samples", "1", "--annotations", "coco,yolo,objects,bop"]
    paths = ["--labels", str(tmp_path / "classes.json"), "-o", str(tmp_path / "views")]
    assert main(["dataset", str(tmp_path / "chair.glb"), *options, *paths]) == 0
    folder = tmp_path / "views"
    (row,) = json.loads((folder / "00000.objects.json").read_text())
    assert (row["name"], row["visible_fraction"]) == ("chair", 1)
    np.testing.assert_allclose(row["size"], (2, 1.2, 1), atol=1e-6)
    (one,) = json.loads((folder / "annotations.json").read_text())["annotations"]
    assert one["area"] == (np.load(folder / "00000.instance_id.npy") < 2).sum()
    assert (one["bbox"], (folder / "00000.txt").read_text().count("\n")) == (row["box"], 1)
    (model,) = json.loads((folder / "bop" / "models" / "models_info.json").read_text()).values()
    np.testing.assert_allclose([model[f"size_{axis}"] for axis in "xyz"], (2000, 1000, 1200), rtol=1e-5)


def test_cameras_are_those_of_the_recipe(recipe, views):
    scene = sv.builtin("cornell_box")
    randomizer = sv.Randomizer.load(recipe / "random.yaml", 0)
    frames = json.loads((views / "transforms.json").read_text())["frames"]
    for number, camera in enumerate(cameras_for(str(recipe / "poses.json"), scene, scene.camera, 5, 40 / 32, 0)):
        before = camera.vertical_fov
        randomizer.camera(camera, number)
        assert camera.vertical_fov != before
        assert frames[number]["fl_y"] == pytest.approx(camera.intrinsics((40, 32))[1, 1])
        np.testing.assert_allclose(frames[number]["transform_matrix"], camera.transform, atol=1e-9)


def refused(recipe, folder, capsys, text, *more):
    """What `dataset` says of this recipe, before anything is rendered."""
    (folder / "random.yaml").write_text(text)
    run(recipe, folder / "views", "--views", 2, "--randomize", folder / "random.yaml", *more, code=2)
    assert not list((folder / "views").iterdir())
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("instances: {'tall block': {scale: [0.5, 1]}}", "BOP: Instance 'tall block' has another size"),
        ("cameras: {projection: fisheye}", "cameras are perspective and without distortion"),
        ("cameras: {orthographic_height: 2}", "cameras are perspective and without distortion"),
    ],
)
def test_what_bop_lacks_is_refused_first(recipe, tmp_path, capsys, monkeypatch, text, words):
    monkeypatch.setattr("solari_vk.data.cli.dataset.open_pool", lambda job: pytest.fail("renders"))
    assert words in refused(recipe, tmp_path, capsys, text, "--annotations", "bop")


def test_distractors_have_neither_labels_nor_keypoints(recipe, tmp_path, any_device):
    """Patterns that fit all leave them out; a fixed scale is BOP's size; the recipe's seed is that of the cameras."""
    for name, table in (("classes", {"*": "thing"}), ("points", {"*": {"first": 0, "last": 3}})):
        (tmp_path / f"{name}.json").write_text(json.dumps(table))
    (tmp_path / "random.yaml").write_text(
        "seed: 5\ninstances: {'tall block': {scale: 0.5}}\ndistractors: {count: 3, shapes: cone}"
    )
    folder = run(
        recipe,
        tmp_path / "views",
        "--views",
        1,
        "--cameras",
        "random",
        "--keypoints",
        tmp_path / "points.json",
        "--labels",
        tmp_path / "classes.json",
        "--randomize",
        tmp_path / "random.yaml",
        "--annotations",
        "coco,bop",
    )
    table = {row["name"]: row for row in json.loads((folder / "instances.json").read_text())["instances"]}
    assert {name for name, row in table.items() if not row["label"]} == {f"distractor {number}" for number in range(3)}
    rows = np.load(folder / "00000.keypoints.npy")
    assert set(rows[:, 0]) == {row["id"] for row in table.values() if row["label"]}
    names = json.loads((folder / "bop" / "objects.json").read_text())
    (number,) = (number for number, row in names.items() if row["name"] == "tall block")
    model = json.loads((folder / "bop" / "models" / "models_info.json").read_text())[number]
    assert model["size_z"] == pytest.approx(500 * table["tall block"]["size"][1], rel=1e-3)
    scene = sv.builtin("cornell_box")
    (camera,) = cameras_for("random", scene, scene.camera, 1, 40 / 32, 5)
    (frame,) = json.loads((folder / "transforms.json").read_text())["frames"]
    np.testing.assert_allclose(frame["transform_matrix"], camera.transform, atol=1e-6)
