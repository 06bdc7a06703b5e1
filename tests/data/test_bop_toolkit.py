"""A BOP data set of the command line, read by the benchmark's own package, which says what its labels should be."""

from __future__ import annotations

import json

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.lab.embree import embree_scene

pytest.importorskip(
    "bop_toolkit_lib", reason="needs bop_toolkit: python -m pip install git+https://github.com/thodan/bop_toolkit"
)
from bop_toolkit_lib import dataset_params, inout, misc, visibility

SIDES = "min_x", "min_y", "min_z", "size_x", "size_y", "size_z"
DELTA = 15  # millimeters, of the script calc_gt_info


def objects():
    """Two rings of one mesh, one of which is partly hidden and the other cut by the picture's edge; one that is
    hidden; one that is mirrored; one that no picture shows; and one of two parts."""
    ring, block = sv.shapes.torus(radius=0.3, tube_radius=0.12, segments=16), sv.shapes.box()
    scene = sv.Scene()
    scene.add(ring, name="ring 1", position=(-0.3, 0, 0), rotation=(0.5, 0.5, 0.5, 0.5))
    scene.add(ring, name="ring 2", position=(1.35, 0.1, 0.2), rotation=0.4)
    scene.add(sv.shapes.cone(), name="block", position=(-0.1, -0.2, 0.6), scale=(0.4, 0.7, 0.2), rotation=0.3)
    scene.add(block, name="hidden block", position=(-0.16, -0.25, -0.5), scale=0.12)
    scene.add(
        sv.Mesh(ring.positions + np.float32(0.1), ring.triangles),
        name="mirrored ring",
        transform=np.diag((-0.6, 0.6, 0.6, 1)) + np.eye(4)[3] * np.array([[-0.9, 0.4, 0.2, 0]]).T,
    )
    scene.add(block, name="block behind", position=(0, 0, 9), scale=0.4)
    mug = sv.shapes.cylinder(0.2, 0.4, 16), sv.shapes.torus(0.12, 0.04, 12)
    for mesh, x, scale in zip(mug, (0.4, 0.6), ((1, 1, 1), (1, 1, 0.5)), strict=True):
        scene.add(mesh, name=f"mug {x}", position=(x, -0.35, 0.4), scale=scale, rotation=0.2, part_of="mug")
    scene.environment = sv.Environment((1, 1, 1))
    return scene


def depth_of(model, pose, intrinsics, size):
    """The depth in millimeters of a model alone, by Embree, in a picture of three times the width and height."""
    corners = misc.transform_pts_Rt(model["pts"], pose["cam_R_m2c"], pose["cam_t_m2c"])[model["faces"].astype(int)]
    columns, rows = np.meshgrid(*(np.arange(-side, 2 * side) for side in size))
    directions = np.stack([columns, rows, np.ones_like(rows)], -1).reshape(-1, 3) @ np.linalg.inv(intrinsics).T
    hit = embree_scene(corners).run(np.zeros(directions.shape, np.float32), directions.astype(np.float32))
    a, b, c = np.moveaxis(corners[hit], 1, 0)
    normals = np.cross(b - a, c - a)
    depth = np.einsum("ni,ni->n", a, normals) / np.einsum("ni,ni->n", directions, normals)
    return np.where(hit >= 0, depth, 0.0).reshape(rows.shape)


def info_of(large, distance, seen, size):
    """As calc_gt_info.py has it."""
    width, height = size
    own = large[height : 2 * height, width : 2 * width] > 0
    boxes = [[-1] * 4] * 2
    if seen.any():
        boxes = [
            misc.calc_2d_bbox(*(places - corner for places, corner in zip(mask.nonzero()[::-1], low, strict=True)))
            for mask, low in ((large > 0, size), (seen, (0, 0)))
        ]
    return {
        "px_count_all": (large > 0).sum(),
        "px_count_valid": (distance[own] > 0).sum(),
        "px_count_visib": seen.sum(),
        "visib_fract": seen.sum() / max((large > 0).sum(), 1),
        "bbox_obj": boxes[0],
        "bbox_visib": boxes[1],
    }


@pytest.mark.parametrize(("kind", "split_type"), [("png", None), ("jpg", "pbr")])
def test_bop_toolkit_reads_a_data_set(any_device, tmp_path, kind, split_type):
    """Models, posed and rendered alone, and the toolkit's visibility give the masks, counts and boxes of the files."""
    objects().save(tmp_path / "objects.glb")
    poses = [{"position": [x, 0.3, 2.6], "target": [0, 0, 0]} for x in (-0.3, 0, 0.4)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    (tmp_path / "classes.json").write_text('{"*ring*": "ring", "*block*": "block", "mug*": "mug"}')
    options = f"--size 96x64 --samples 2 --format {kind} --annotations bop --labels {tmp_path / 'classes.json'}".split()
    paths = ["--cameras", str(tmp_path / "poses.json"), "-o", str(tmp_path / "views")]
    assert main(["dataset", str(tmp_path / "objects.glb"), *options, *paths]) == 0
    (tmp_path / "views" / "bop").rename(tmp_path / "lm")  # one of the names that the toolkit knows
    split = dataset_params.get_split_params(tmp_path, "lm", "train", split_type)
    models = dataset_params.get_model_params(tmp_path, "lm")
    assert dataset_params.get_present_scene_ids(split) == [0]
    table = inout.load_json(models["models_info_path"], keys_to_int=True)
    meshes = {number: inout.load_ply(models["model_tpath"].format(obj_id=number)) for number in table}
    for number, mesh in meshes.items():
        expected = dict(zip(SIDES, misc.calc_3d_bbox(*mesh["pts"].T), strict=True))
        assert table[number] == pytest.approx(expected | {"diameter": misc.calc_pts_diameter(mesh["pts"])}, rel=1e-5)

    assert table[1]["diameter"] == pytest.approx(2 * (300 + 120))  # millimeters

    def read(name, number, index=0, load=inout.load_im):
        return load(split[f"{name}_tpath"].format(scene_id=0, im_id=number, gt_id=index))

    cameras = inout.load_scene_camera(split["scene_camera_tpath"].format(scene_id=0))
    truth = inout.load_scene_gt(split["scene_gt_tpath"].format(scene_id=0))
    infos = inout.load_json(split["scene_gt_info_tpath"].format(scene_id=0), keys_to_int=True)
    shared = dataset_params.get_camera_params(tmp_path, "lm")
    fractions = []
    for number in range(3):
        intrinsics = cameras[number]["cam_K"]
        scale = cameras[number]["depth_scale"]
        size = shared["im_size"]
        assert np.array_equal(intrinsics, shared["K"])
        assert read("rgb", number).shape == (*size[::-1], 3)
        distance = misc.depth_im_to_dist_im_fast(read("depth", number, load=inout.load_depth) * scale, intrinsics)
        for index, (pose, info) in enumerate(zip(truth[number], infos[number], strict=True)):
            mesh = meshes[pose["obj_id"]]
            large = depth_of(mesh, pose, intrinsics, size)
            own = large[size[1] : 2 * size[1], size[0] : 2 * size[0]]
            seen = visibility.estimate_visib_mask_gt(distance, misc.depth_im_to_dist_im_fast(own, intrinsics), DELTA)
            assert np.array_equal(read("mask", number, index), 255 * (own > 0))
            assert np.array_equal(read("mask_visib", number, index), 255 * seen)
            assert info == info_of(large, distance, seen, size)
            if seen.any():
                pixels = misc.project_pts(mesh["pts"], intrinsics, pose["cam_R_m2c"], pose["cam_t_m2c"])
                x, y, width, height = info["bbox_obj"]
                margins = np.array([(x, y) - pixels.min(axis=0), pixels.max(axis=0) - (x + width, y + height)])
                assert (margins >= 0).all()
                assert (margins < 2).all()  # a corner may lie between pixels
            fractions.append(info["visib_fract"])
    assert [pose["obj_id"] for pose in truth[0]] == [1, 1, 2, 3, 4, 5, 6]
    assert min(fractions) == 0
    assert sum(0.1 < fraction < 0.9 for fraction in fractions) >= 3
    assert max(fractions) == 1
