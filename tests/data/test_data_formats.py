"""Files of data sets, read by the packages that users read them with, or as their format's page says."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.data.annotate.bop import diameter
from solari_vk.data.annotate.silhouettes import Silhouette
from solari_vk.output.picture import png_bytes

SIZE = (32, 24)


# ---- KITTI ------------------------------------------------------------------------------------------


def test_flow_for_kitti(tmp_path):
    """By OpenCV, which KITTI's readers use: (value - 2^15) / 64, and the third channel says what counts."""
    cv2 = pytest.importorskip("cv2")
    flow = np.random.default_rng(1).uniform(-500, 500, (5, 7, 2))
    flow[0, 0], flow[1, 1] = np.nan, (-512, 511)
    sv.save_kitti_flow(tmp_path / "flow.png", flow)
    read = cv2.imread(str(tmp_path / "flow.png"), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(float)
    counts = read[..., 2] == 1
    assert np.array_equal(counts, np.isfinite(flow).all(axis=-1))
    assert np.abs((read[..., :2] - 2**15) / 64 - flow)[counts].max() <= 1 / 128
    assert not read[0, 0].any()
    sv.save_kitti_flow(tmp_path / "some.png", flow, np.eye(5, 7, dtype=bool))
    read = cv2.imread(str(tmp_path / "some.png"), cv2.IMREAD_UNCHANGED)
    assert read[..., 0].sum() == 4  # the first one isn't finite
    for wrong, valid, words in (
        (flow + 20, None, "hold -512 to 511.984 pixels, not -492 to 531.*valid="),
        (flow[..., 0], None, "not \\(5, 7\\)"),
        (flow, np.ones((5, 7)), "array of bool"),
    ):
        with pytest.raises(SolariError, match=words):
            sv.save_kitti_flow(tmp_path / "wrong.png", wrong, valid)
    assert not (tmp_path / "wrong.png").exists()


def test_disparity_for_kitti(tmp_path):
    disparity = np.random.default_rng(1).uniform(0, 255, (5, 7))
    disparity[0, 0], disparity[1, 1] = np.nan, 0
    sv.save_kitti_disparity(tmp_path / "disparity.png", disparity)
    read = np.asarray(Image.open(tmp_path / "disparity.png"), np.float64)
    assert read[0, 0] == 0
    assert read[1, 1] == 1  # 0 would not count
    assert np.nanmax(np.abs(read / 256 - disparity)[disparity > 0]) <= 1 / 512
    with pytest.raises(SolariError, match=r"hold 0 to 255\.996"):
        sv.save_kitti_disparity(tmp_path / "wrong.png", -disparity)
    sv.save_kitti_disparity(tmp_path / "largest.png", [[255.99]])


# ---- WebDataset -------------------------------------------------------------------------------------


def test_shards_are_read_by_webdataset(tmp_path):
    webdataset = pytest.importorskip("webdataset")
    picture = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
    (tmp_path / "note.txt").write_text("a file")
    samples = [
        (
            f"{n:05}",
            {
                "png": png_bytes(picture),
                "depth.npy": np.full((4, 5), n, np.float32),
                "json": {"n": n},
                "txt": tmp_path / "note.txt",
            },
        )
        for n in range(5)
    ]
    paths = sv.save_shards(tmp_path / "shards", samples, per_shard=2)
    assert [path.name for path in paths] == ["000000.tar", "000001.tar", "000002.tar"]
    read = list(webdataset.WebDataset([str(path) for path in paths], shardshuffle=False).decode("rgb8"))
    assert [sample["__key__"] for sample in read] == [key for key, _ in samples]
    for number, sample in enumerate(read):
        assert np.array_equal(sample["png"], picture)
        assert np.array_equal(sample["depth.npy"], np.full((4, 5), number))
        assert sample["json"] == {"n": number}
        assert sample["txt"] == "a file"
    again = sv.save_shards(tmp_path / "again", samples, per_shard=2)
    assert [hashlib.sha256(path.read_bytes()).digest() for path in again] == [
        hashlib.sha256(path.read_bytes()).digest() for path in paths
    ]
    longer = "k" * 120, {"json": {"n": np.float32(0.5)}, "cls": np.int64(3)}
    assert sv.save_shards(tmp_path / "again", [*samples, longer], per_shard=9) == again[:1], "others are removed"
    assert [path.name for path in (tmp_path / "again").iterdir()] == ["000000.tar"]
    read = list(webdataset.WebDataset(str(again[0]), shardshuffle=False).decode())
    assert (read[-1]["__key__"], read[-1]["json"], read[-1]["cls"]) == ("k" * 120, {"n": 0.5}, 3)
    for wrong, words in (
        ([("a.b", {})], "a dot or a slash"),
        ([("a", {}), ("a", {})], "is there already"),
        ([("a", {"txt": tmp_path / "none"})], "there is no such file"),
        ([("a", {"x": object()})], "a.x: object can't be written as JSON"),
    ):
        with pytest.raises(SolariError, match=words):
            sv.save_shards(tmp_path / "wrong", wrong)
    assert not list((tmp_path / "wrong").glob("*.tar"))


# ---- BOP --------------------------------------------------------------------------------------------


def bop_scene():
    """Two instances of one object, another size of it, and one that is mirrored."""
    scene = sv.Scene()
    mesh = sv.shapes.torus(segments=12)
    transform = np.diag((-0.4, 0.4, 0.4, 1.0))
    scene.add(mesh, name="ring", position=(-1, 0, 0), rotation=0.3)
    scene.add(mesh, name="ring", position=(1, 0.2, 0.1), rotation=(0.5, 0.5, 0.5, 0.5))
    scene.add(mesh, name="small ring", position=(0, 0.5, 0), scale=0.5)
    scene.add(sv.Mesh(mesh.positions + np.float32(0.2), mesh.triangles), name="mirrored", transform=transform)
    return scene


def silhouette(*, shift=0):
    mask, seen = np.zeros((2, SIZE[1], SIZE[0]), bool)
    mask[4:9, 3:11] = seen[4:9, 3:7] = True
    return Silhouette(mask, seen, 50 + shift, (1, 4, 10, 5))


def read_bop(folder):
    """The tables as bop_toolkit_lib.inout reads them: matrices by rows."""
    scene = folder / "train" / "000000"
    cameras, poses, infos = (
        json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")
    )
    for row in cameras.values():
        row["cam_K"], row["cam_R_w2c"] = (np.reshape(row[name], (3, 3)) for name in ("cam_K", "cam_R_w2c"))
    for row in (row for rows in poses.values() for row in rows):
        row["cam_R_m2c"], row["cam_t_m2c"] = np.reshape(row["cam_R_m2c"], (3, 3)), np.array(row["cam_t_m2c"])
    return cameras, poses, infos


def test_bop_models_are_where_the_instances_are(tmp_path):
    """The vertices of the models, posed and projected as BOP says, are the instances' in the picture."""
    scene = bop_scene()
    instances = dict(enumerate(scene.instances))
    looking = sv.Camera.look_at((0.5, 1, 5), (0, 0, 0), principal_point=(0.4, 0.55), pixel_aspect=1.1)
    depth = np.full(SIZE[::-1], np.inf, np.float32)
    depth[2:, 3:] = np.linspace(0.5, 9, depth[2:, 3:].size).reshape(depth[2:, 3:].shape)
    writer = sv.BopWriter(tmp_path, instances)
    picture = png_bytes(np.random.default_rng(1).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8))
    writer.add(3, looking, picture, depth, {number: silhouette() for number in instances})
    writer.finish()
    cameras, poses, infos = read_bop(tmp_path)
    assert [row["obj_id"] for row in poses["3"]] == [1, 1, 2, 3]
    models_info = json.loads((tmp_path / "models" / "models_info.json").read_text())
    for row, instance in zip(poses["3"], scene.instances, strict=True):
        model = trimesh.load(tmp_path / "models" / f"obj_{row['obj_id']:06}.ply", process=False)
        assert np.linalg.det(row["cam_R_m2c"]) == pytest.approx(1)
        posed = model.vertices @ row["cam_R_m2c"].T + row["cam_t_m2c"]
        pixels = posed @ cameras["3"]["cam_K"].T
        world = instance.mesh.positions @ instance.transform[:3, :3].T + instance.transform[:3, 3]
        np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], looking.project(world, SIZE), atol=1e-3)
        assert model.volume > 0  # not inside out
        np.testing.assert_allclose(np.einsum("ni,ni->n", model.vertex_normals, normals_of(model)), 1, atol=0.2)
        info = models_info[str(row["obj_id"])]
        apart = np.linalg.norm(model.vertices[:, None] - model.vertices, axis=-1)
        assert info["diameter"] == pytest.approx(apart.max(), rel=1e-4)
        np.testing.assert_allclose(model.bounds[0], [info[f"min_{axis}"] for axis in "xyz"], atol=1e-2)
        np.testing.assert_allclose(np.ptp(model.bounds, axis=0), [info[f"size_{axis}"] for axis in "xyz"], atol=1e-2)
    folder = tmp_path / "train" / "000000"
    millimeters = np.asarray(Image.open(folder / "depth" / "000003.png"), float) * cameras["3"]["depth_scale"]
    np.testing.assert_allclose(millimeters, np.where(np.isfinite(depth), depth * 1000, 0), atol=0.1)
    assert (folder / "rgb" / "000003.png").read_bytes() == picture
    rotation, shift = looking.extrinsics()
    np.testing.assert_allclose(cameras["3"]["cam_R_w2c"], rotation)
    np.testing.assert_allclose(cameras["3"]["cam_t_w2c"], shift * 1000)
    assert infos["3"][1] == {
        "px_count_all": 50,
        "px_count_visib": 20,
        "visib_fract": 0.4,
        "bbox_obj": [1, 4, 9, 4],
        "bbox_visib": [3, 4, 3, 4],
        "px_count_valid": 40,
    }
    for kind, expected in (("mask", silhouette().mask), ("mask_visib", silhouette().visible)):
        assert np.array_equal(np.asarray(Image.open(folder / kind / "000003_000001.png")), expected * 255)


def normals_of(model):
    """As trimesh computes them of the triangles alone."""
    return trimesh.Trimesh(model.vertices, model.faces, process=False).vertex_normals


@pytest.mark.parametrize("scale", [0.012345, 0.000125, 1.234565])
def test_turned_instances_of_one_size_are_one_object(tmp_path, scale):
    mesh, rng = sv.shapes.box((0, 0, 0), (1, 2, 3)), np.random.default_rng(1)
    boxes = {number: sv.Instance(mesh, scale=scale) for number in range(30)}
    for box in boxes.values():
        box.rotation = Rotation.random(random_state=rng).as_matrix()
    boxes[30] = sv.Instance(mesh, scale=1.004 * scale)
    sv.BopWriter(tmp_path, boxes).finish()
    assert set(json.loads((tmp_path / "objects.json").read_text())) == {"1", "2"}


def test_what_bop_does_not_have(tmp_path):
    scene = bop_scene()
    instances = dict(enumerate(scene.instances))
    writer, depth = sv.BopWriter(tmp_path, instances), np.ones(SIZE[::-1])
    picture = png_bytes(np.zeros((*depth.shape, 3), np.uint8))
    with pytest.raises(SolariError, match="perspective and without distortion"):
        writer.add(0, sv.Camera(projection="fisheye"), picture, depth, {})
    with pytest.raises(SolariError, match=r"the split train_pbr are \.jpg files"):
        sv.BopWriter(tmp_path, instances, split="train_pbr").add(0, sv.Camera(), picture, depth, {})
    scene.instances[2].scale = 0.7
    with pytest.raises(SolariError, match="'small ring' has another size"):
        writer.add(0, sv.Camera(), picture, depth, {2: silhouette()})
    mesh = sv.Mesh(np.eye(3), deformation=sv.Deformation(targets=np.ones((1, 3, 3))))
    with pytest.raises(SolariError, match="rigid"):
        sv.BopWriter(tmp_path, {0: sv.Instance(mesh, morph_weights=[1])})


def test_diameters():
    for points in (np.random.default_rng(1).normal(size=(500, 3)) * (3, 1, 1), sv.shapes.sphere(segments=16).positions):
        points = np.asarray(points, np.float64)
        apart = np.linalg.norm(points[:, None] - points, axis=-1)
        assert diameter(points) == pytest.approx(apart.max())
