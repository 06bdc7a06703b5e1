"""Labels of objects and motion: silhouettes, boxes in space, keypoints, flow, each against another oracle."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from oracles.rays import World

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.data.annotate.silhouettes import read_runs
from solari_vk.scene.matrices import transform_points

SIZE = (48, 40)
BLOCK = sv.shapes.box((-0.5,) * 3, (0.5,) * 3)


@pytest.fixture(scope="module")
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture(scope="module")
def camera(scene):
    return sv.Camera(transform=scene.camera.transform, vertical_fov=scene.camera.vertical_fov)


@pytest.fixture(scope="module")
def tracer(device, scene):
    with sv.RayTracer(device, scene) as made:
        yield made


def ids_of(device, scene, camera, size=SIZE):
    """What each pixel shows, as the first hits of a batch have it."""
    with sv.Batch(device, scene, size, 1) as batch:
        ids, instances = batch.render([camera])["instance_id"][0], batch.instances
    return {instance: ids == number for number, instance in instances.items()}


# ---- silhouettes ------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["perspective", "fisheye", "orthographic"])
def test_a_silhouette_is_what_is_seen_without_the_others(device, scene, camera, tracer, projection):
    kind = {"perspective": {}, "fisheye": {"projection": "fisheye"}, "orthographic": {"orthographic_height": 2.2}}
    looking = sv.Camera(transform=camera.transform, vertical_fov=camera.vertical_fov, **kind[projection])
    found = sv.silhouettes(tracer, looking, SIZE)
    seen = ids_of(device, scene, looking)
    hidden = 0
    for instance in scene.instances:
        alone = sv.Scene(sv.Instance(instance.mesh, instance.material, instance.transform))
        (mask,) = ids_of(device, alone, looking).values()
        if instance not in found:
            assert not mask.any()  # a wall seen from its edge
            continue
        silhouette = found[instance]
        assert np.mean(silhouette.mask != mask) <= 0.001
        assert np.mean(silhouette.visible != seen[instance]) <= 0.001
        assert silhouette.fraction == silhouette.visible.sum() / silhouette.mask.sum()
        rows, columns = np.nonzero(silhouette.mask)
        assert silhouette.box == (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)
        hidden += silhouette.fraction < 0.95
    assert hidden >= 2


def test_half_hidden_and_half_outside(device):
    """Counted by hand: an orthographic picture of 20x20 m, with a pixel a meter."""
    flat = sv.shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0))
    scene = sv.Scene()
    scene.add(flat, name="far", position=(-10, 0, -5))
    scene.add(flat, name="near", position=(-10, 2, 0))
    scene.add(flat, name="behind the camera", position=(0, 0, 20))
    looking = sv.Camera(position=(0, 0, 10), orthographic_height=20)
    with sv.RayTracer(device, scene) as tracer:
        inside, around = (sv.silhouettes(tracer, looking, (20, 20), around=share) for share in (0, 1))
    assert {instance.name for instance in around} == {"far", "near"}
    far, near = scene.instances["far"], scene.instances["near"]
    assert (inside[far].pixel_count, inside[far].visible.sum(), inside[far].fraction) == (8, 4, 0.5)
    assert inside[far].box == (0, 8, 2, 4)
    assert (around[far].pixel_count, around[far].mask.sum(), around[far].fraction) == (16, 8, 0.25)
    assert around[far].box == (-2, 8, 4, 4)
    assert inside[near].fraction == 1
    with pytest.raises(SolariError, match="around is from 0 to 8"):
        sv.silhouettes(tracer, sv.Camera(projection="fisheye"), (20, 20), around=1)


def test_parts_of_an_object_have_one_silhouette(device):
    """That of a mesh of both, partly hidden and partly outside; a part with another label is apart."""
    shifted = BLOCK.positions + np.float32(0.4)
    joined = sv.Mesh(
        np.concatenate([BLOCK.positions, shifted]), np.concatenate([BLOCK.triangles, BLOCK.triangles + len(shifted)])
    )
    looking, found = sv.Camera(position=(0.7, 0, 4), vertical_fov=0.5), []
    for meshes in ([BLOCK, sv.Mesh(shifted, BLOCK.triangles)], [joined]):
        scene = sv.Scene()
        parts = [scene.add(mesh, part_of="chair", position=(-0.4, 0, 0)) for mesh in meshes]
        scene.add(BLOCK, scale=0.4, position=(0.2, 0, 1))
        with sv.RayTracer(device, scene) as tracer:
            found.append(sv.silhouettes(tracer, looking, SIZE, around=1, merge=True))
            assert len(found[-1]) == 2
            one, other = found[-1][parts[0]], found[0][next(iter(found[0]))]
            assert (one.pixel_count, one.box) == (other.pixel_count, other.box)
            assert np.array_equal(one.mask, other.mask)
            assert np.array_equal(one.visible, other.visible)
            inside = sv.silhouettes(tracer, looking, SIZE, merge=True)[parts[0]]
            assert inside.pixel_count == inside.mask.sum()
            parts[-1].label = "cushion"
            assert len(sv.silhouettes(tracer, looking, SIZE, merge=True)) == 1 + len(parts)
    assert 0 < one.fraction < 1
    assert one.box[0] < 0


def test_pixels_that_another_renderer_sees_count():
    """Runs in and around the picture, and a pixel of the picture that is in none of them."""
    seen = np.zeros((3, 4), bool)
    seen[2, 3] = seen[1, 1] = True
    runs = np.array([[5, -2, 1, 4], [4, 0, 0, 2], [5, 0, 0, 1]], np.int32)
    found = read_runs(runs, {5: seen, 6: np.zeros((3, 4), bool)})
    assert found[5].mask.tolist() == [[1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0, 1]]
    assert (found[5].pixel_count, found[5].fraction, found[5].box) == (6, 2 / 6, (-2, 0, 6, 3))
    assert (found[6].pixel_count, found[6].fraction, found[6].box) == (0, 0, (0, 0, 0, 0))


def test_wrong_arguments(tracer, camera):
    for call, words in (
        (lambda: sv.silhouettes(camera, camera, SIZE), "silhouettes: a RayTracer is needed, not <Camera"),
        (lambda: sv.keypoints(tracer, 3, SIZE, {}), "keypoints: a Camera is needed, not 3"),
        (lambda: sv.optical_flow(tracer, (camera, camera), (0.5, 3)), "size is .width, height. in pixels"),
    ):
        with pytest.raises(SolariError, match=words):
            call()


def test_back_faces_hide_nothing(device):
    """As in pictures: the back of a single-sided surface isn't seen, that of a double-sided one is."""
    for double_sided, fraction in ((False, 1.0), (True, 0.0)):
        scene = sv.Scene()
        wall = sv.shapes.quad((0, 0, 2), (3, 0, 0), (0, -3, 0))  # whose front faces away
        scene.add(wall, sv.Material(double_sided=double_sided), name="wall")
        block = scene.add(BLOCK, name="block")
        with sv.RayTracer(device, scene) as tracer:
            found = sv.silhouettes(tracer, sv.Camera(position=(0, 0, 5)), SIZE)
        assert found[block].fraction == fraction
        assert (len(found) == 2) == double_sided


# ---- boxes ------------------------------------------------------------------------------------------


def test_boxes_are_around_what_is_seen():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(2)
    looking = sv.Camera.look_at((1, 2, 6), (0, 0.2, 0), distortion=(-0.1, 0.02, 0.001, 0))
    matrices = [np.eye(3), np.diag((1, 2, 3.0)), np.diag((-1, 1, 1.0)), np.array([[1, 0.4, 0], [0, 1, 0], [0, 0, 2]])]
    for matrix in matrices:
        turn = cv2.Rodrigues(rng.normal(size=3))[0]
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = turn @ matrix, rng.normal(size=3) * 0.3
        instance = sv.Instance(sv.shapes.torus(), transform=transform)
        box = sv.boxes_3d([instance], looking, SIZE)[instance]
        rotation, shift = looking.extrinsics()
        points = transform_points(transform, instance.mesh.positions) @ rotation.T + shift
        inside = (points - box.center) @ box.rotation
        np.testing.assert_allclose(inside.max(axis=0), box.size / 2, atol=1e-6)
        np.testing.assert_allclose(inside.min(axis=0), -box.size / 2, atol=1e-6)
        assert np.linalg.det(box.rotation) == pytest.approx(1)
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        expected = cv2.projectPoints(
            signs * box.size / 2,
            cv2.Rodrigues(box.rotation)[0],
            box.center,
            looking.intrinsics(SIZE),
            looking.distortion,
        )[0][:, 0]
        np.testing.assert_allclose(box.pixels, expected, atol=1e-5)


def test_a_box_follows_the_pose():
    mesh = sv.Mesh(BLOCK.positions, BLOCK.triangles, deformation=sv.Deformation(targets=BLOCK.positions[None] * 2))
    instance = sv.Instance(mesh, morph_weights=[0.5])
    box = sv.boxes_3d([instance], sv.Camera(position=(0, 0, 5)), SIZE)[instance]
    assert box.size.tolist() == [2, 2, 2]
    assert box.center.tolist() == [0, 0, 5]


# ---- keypoints --------------------------------------------------------------------------------------


def test_keypoints(device, tmp_path):
    scene = sv.Scene()
    left, right = (scene.add(BLOCK, name=f"block {n}", position=(x, 0, 0)) for n, x in ((1, -0.8), (2, 0.8)))
    scene.add(BLOCK, name="before", position=(-0.55, 0.2, 2), scale=0.3)
    looking = sv.Camera(position=(0, 0, 5), vertical_fov=0.6)
    points = {
        "block 1": {"front": [0.3, -0.3, 0.5], "behind": [0, 0.3, 0.5], "back": [0, 0, -0.5], "middle": [0] * 3},
        "block*": {"front": [0, 0, 0.5], "far off": [9, 0, 0], "corner": 0},
    }
    (tmp_path / "points.json").write_text(json.dumps(points))
    with sv.RayTracer(device, scene) as tracer:
        found = sv.keypoints(tracer, looking, SIZE, points)
        assert {name: point.state for name, point in found[left].items()} == {
            "front": 2,
            "behind": 1,
            "back": 1,
            "middle": 1,
        }
        assert {name: point.state for name, point in found[right].items()} == {"front": 2, "far off": 0, "corner": 2}
        np.testing.assert_array_equal(found[right]["corner"].position, BLOCK.positions[0] + (0.8, 0, 0))
        np.testing.assert_array_equal(found[right]["front"].pixel, looking.project((0.8, 0, 0.5), SIZE))
        read = sv.keypoints(tracer, looking, SIZE, tmp_path / "points.json", tolerance=0.6)
        assert [read[left][name].state for name in ("front", "behind", "back", "middle")] == [2, 1, 1, 2]
        left.part_of = right.part_of = "wall"
        assert list(sv.keypoints(tracer, looking, SIZE, {"wall": {"front": 0}})) == [left]
        left.part_of, left.visible = "", False
        assert list(sv.keypoints(tracer, looking, SIZE, points)) == [right]
        for wrong, words in (
            ({"chair": {"seat": [0, 0, 0]}}, "no instance is named 'chair'"),
            ({"block 2": {"seat": [0, 0]}}, "'seat' of Instance 'block 2': is three numbers, or a vertex from 0 to 2"),
            ({"block 2": {"seat": 99}}, "vertex from 0"),
            ({"block 2": [0, 0, 0]}, "give points by name"),
        ):
            with pytest.raises(SolariError, match=words):
                sv.keypoints(tracer, looking, SIZE, wrong)


# ---- flow -------------------------------------------------------------------------------------------


def look_up(picture, at):
    """The values of the nearest pixels."""
    column, row = np.rint(at).astype(int).T
    return picture[row, column]


def moving_scene():
    """A box that moves, one that turns, one whose vertices are edited, before a wall; and pose(time)."""
    scene = sv.Scene()
    scene.add(sv.shapes.quad((0, 0, -2), (5, 0, 0), (0, 5, 0)), sv.Material(base_color=(0.1, 0.2, 0.9)), name="wall")
    slides = scene.add(BLOCK, sv.Material(base_color=(0.9, 0.1, 0.1)), name="slides")
    turns = scene.add(BLOCK, sv.Material(base_color=(0.1, 0.9, 0.1)), name="turns")
    edited = scene.add(sv.Mesh(BLOCK.positions, BLOCK.triangles), sv.Material(base_color=0.8), name="edited")

    def pose(time):
        slides.position = (-1 + 0.7 * time, 0, 0.3)
        turns.update(position=(1, 0, 0), rotation=0.5 * time)
        edited.mesh.positions = BLOCK.positions * (1 + 0.3 * time) + np.array((0, -1, 0.5))

    return scene, pose


def test_flow_leads_to_the_next_picture(device):
    """Warped by the flow, the surfaces and colors are those of the next picture; occlusion is Embree's."""
    size = (96, 80)
    scene, pose = moving_scene()
    cameras = sv.Camera.look_at((0.2, 0.6, 5), (0, 0, 0)), sv.Camera.look_at((0, 0.7, 4.8), (0.05, 0, 0))
    with sv.RayTracer(device, scene) as tracer:
        forward, backward = sv.optical_flow(tracer, cameras, size, pose=pose, times=(0.2, 0.9))
    pictures = []
    for camera, time in zip(cameras, (0.2, 0.9), strict=True):
        pose(time)
        with sv.Batch(device, scene, size, 1, outputs=["position", "albedo", "depth"]) as batch:
            batch.render([camera])
            pictures.append({name: batch[name][0] for name in batch})
    grid = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1)
    for flow, (here, there), camera, time in (
        (forward, pictures, cameras[1], 0.9),
        (backward, pictures[::-1], cameras[0], 0.2),
    ):
        pose(time)
        at = grid + flow.flow
        seen = flow.state == 0
        assert 0.7 < seen.mean() < 0.98
        assert (flow.state == 1).sum() > 50
        moved = here["position"] + flow.scene_flow
        np.testing.assert_allclose(camera.project(moved, size)[seen], at[seen], atol=2e-3)
        assert np.abs(look_up(there["albedo"], at[seen]) - here["albedo"][seen]).mean() < 0.01
        world = World(scene)
        inside = flow.state != 2
        directions = moved[inside] - camera.position
        hit = world.embree_hits(np.broadcast_to(camera.position, directions.shape), directions)
        a, b, c = np.moveaxis(world.corners[hit], 1, 0)
        normal = np.cross(b - a, c - a)
        share = np.einsum("ni,ni->n", a - camera.position, normal) / np.einsum("ni,ni->n", directions, normal)
        assert np.mean((share < 1 - 1e-4) == (flow.state[inside] == 1)) >= 0.999


def test_what_stands_still_has_no_flow(device, tracer, camera):
    forward, backward = sv.optical_flow(tracer, (camera, camera), SIZE)
    for flow in (forward, backward):
        assert np.nanmax(np.abs(flow.flow)) < 1e-4
        assert np.nanmax(np.abs(flow.scene_flow)) == 0
        assert not flow.state.any()


def test_a_background_of_parallel_rays_has_no_flow(tracer, camera):
    wide = sv.Camera(transform=camera.transform, orthographic_height=20)
    forward, _ = sv.optical_flow(tracer, (wide, wide), SIZE)
    empty = np.isnan(forward.flow).any(axis=-1)
    assert 0.2 < empty.mean() < 1
    assert (forward.state[empty] == 2).all()
    assert np.abs(forward.flow[~empty]).max() < 1e-3


def test_a_stereo_pair_has_disparity(device, scene, camera, tracer):
    baseline = 0.1
    right = sv.Camera(transform=camera.transform, vertical_fov=camera.vertical_fov)
    right.position = camera.position + baseline * camera.rotation[:, 0]
    left_to_right, back = sv.optical_flow(tracer, (camera, right), SIZE)
    with sv.Batch(device, scene, SIZE, 1, outputs=["depth"]) as batch:
        depth = batch.render([camera])["depth"][0]
    expected = camera.intrinsics(SIZE)[0, 0] * baseline / depth
    there = np.isfinite(depth)
    np.testing.assert_allclose(left_to_right.disparity[there], expected[there], rtol=1e-4)
    assert np.abs(left_to_right.flow[there][:, 1]).max() < 1e-4
    assert (back.disparity[there] < 0.01).all()
    assert (left_to_right.state == 1).any()


def test_the_background_turns_with_the_camera(device):
    scene = sv.Scene(sv.Instance(BLOCK))
    first, second = (sv.Camera(position=(0, 0, 4), rotation=turn, vertical_fov=0.8) for turn in (0.0, 0.1))
    with sv.RayTracer(device, scene) as tracer:
        forward, _ = sv.optical_flow(tracer, (first, second), (33, 33))
    assert forward.flow[16, 0] == pytest.approx(
        second.project(first.rays((0, 16), (33, 33))[1] * 1e6, (33, 33)) - (0, 16), abs=1e-3
    )
    assert np.isnan(forward.scene_flow[16, 0]).all()
    assert forward.state[16, 32] in (0, 2)
    assert math.isfinite(forward.flow[16, 16, 0])


def test_flow_of_meshes_that_grow_is_refused(device):
    instance = sv.Instance(sv.Mesh(BLOCK.positions, BLOCK.triangles), name="block")

    def pose(time):
        instance.mesh.update(triangles=BLOCK.triangles[: 12 - int(time)])

    with sv.RayTracer(device, sv.Scene(instance)) as tracer, pytest.raises(SolariError, match="had 11 triangles and"):
        sv.optical_flow(tracer, (sv.Camera(position=(0, 0, 4)),) * 2, SIZE, pose=pose)
    with pytest.raises(SolariError, match="two Camera objects"):
        sv.optical_flow(tracer, (sv.Camera(),), SIZE)
