"""Instances that never moved are in one tree in world space, and hits are those of two levels of trees."""

from __future__ import annotations

import numpy as np
import pytest
from support.seeded_bugs import Bug, expect_noticed

import solari_vk as sv
from solari_vk.bound import flat_instances
from solari_vk.gpu.trees import tree

SIZE = (24, 16)
CAMERA = sv.Camera.look_at((0, 0, 9), (0, 0, 0), fov=60)


@pytest.fixture(scope="module")
def by_compute(any_device):
    with sv.Device(validation=True, rays="compute") as device:
        yield device


def turned(rng):
    """A place, turned, scaled by axes, and mirrored in half of the cases."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.3, 1.5, 3)
    matrix[:3, 3] = rng.uniform(-3, 3, 3)
    return matrix


def crowd(count=30):
    """Boxes and balls of several materials, before a sky with a sun."""
    rng = np.random.default_rng(4)
    meshes = [sv.shapes.box(), sv.shapes.sphere(segments=12), sv.shapes.plane()]
    materials = [sv.Material(base_color=rng.random(3), double_sided=index > 0) for index in range(3)]
    scene = sv.Scene()
    scene.environment = sv.Sky()
    for index in range(count):
        name = f"item {index}"
        scene.add(sv.Instance(meshes[index % 3], materials[index % 2], transform=turned(rng), name=name))
    return scene


def edit(scene, frame):
    """One edit of each kind that takes an instance out of the tree, or brings one in."""
    rng = np.random.default_rng(frame)
    item = scene.instances[f"item {frame}"]
    if frame == 1:
        item.transform = turned(rng)
    elif frame == 2:
        scene.remove(item)
    elif frame == 3:
        item.visible = False
    elif frame == 4:
        item.material = sv.Material(base_color=(1, 0, 0), alpha=0.5, alpha_mode="blend")
    elif frame == 5:
        item.mesh = sv.shapes.sphere(segments=8)
    elif frame == 6:
        ball = scene.instances["item 7"].mesh
        for index in range(30, 60):
            scene.add(sv.Instance(ball, item.material, transform=turned(rng), name=f"item {index}"))
    elif frame == 7:
        for index in range(10, 58):
            scene.instances[f"item {index}"].transform = turned(rng)


def frames(device, renderer):
    """The pictures of frames with an edit before each, and the numbers of instances in the flat tree."""
    scene = crowd()
    options = {"seed": 3} if renderer is sv.PathTracer else {"seed": 3, "settings": sv.Settings(gbuffer="traced")}
    shown, sizes = [], []
    with renderer(device, scene, SIZE, **options) as made:
        for frame in range(9):
            edit(scene, frame)
            picture = made.render(CAMERA, samples=2) if renderer is sv.PathTracer else made.render(CAMERA)
            shown.append([picture[name].copy() for name in ("radiance", "depth", "instance_id")])
            flat = made.binder.tlas.flat_tree
            sizes.append(0 if flat is None else flat.geometry.triangle_count)
    return shown, sizes


@pytest.mark.parametrize("renderer", [sv.PathTracer, sv.Renderer])
def test_pictures_are_those_of_two_levels(by_compute, renderer, monkeypatch):
    found, sizes = frames(by_compute, renderer)
    monkeypatch.setattr(flat_instances, "MAX_TRIANGLES", 0)
    expected, none = frames(by_compute, renderer)
    assert none == [0] * len(none)
    assert sizes[0] == sizes[5] > 0  # single edits don't build it again
    assert sizes[6] > sizes[5]  # many new instances do
    assert sizes[7] < sizes[6]  # and many that move
    for frame, (a, b) in enumerate(zip(found, expected, strict=True)):
        for one, other in zip(a, b, strict=True):
            np.testing.assert_array_equal(one, other, f"frame {frame}")


def test_worlds_move_what_is_in_the_tree(by_compute, monkeypatch):
    """Instances with transforms, or materials, of each world are where the world has them."""

    moved = [f"item {index}" for index in range(5, 20)]

    def taken(batch):
        frame = batch.render([CAMERA, CAMERA])
        return {name: frame[name].copy() for name in ("depth", "albedo")}

    def pictures():
        rng = np.random.default_rng(8)
        with sv.Batch(by_compute, crowd(), SIZE, 2, worlds=2, outputs=["depth", "albedo"]) as batch:
            shown = [taken(batch)]
            for name in moved:
                batch.transforms[name] = [turned(rng), turned(rng)]
            batch.world_materials["item 4"] = [sv.Material(), sv.Material(alpha_mode="blend", alpha=0.3)]
            shown.append(taken(batch))
            batch.transforms.clear()
            shown.append(taken(batch))
            return shown

    found = pictures()
    assert (found[0]["depth"] != found[1]["depth"]).any()
    monkeypatch.setattr(flat_instances, "MAX_TRIANGLES", 0)
    for one, other in zip(found, pictures(), strict=True):
        for name, values in one.items():
            np.testing.assert_array_equal(values, other[name], name)


def soup(count, seed=0):
    """A mesh of triangles that lie apart, of which trees have most nodes."""
    rng = np.random.default_rng(seed)
    corners = rng.random((count, 1, 3)) + 0.02 * rng.normal(size=(count, 3, 3))
    return sv.Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def statics(count, triangles, meshes):
    shapes = [soup(triangles, seed) for seed in range(meshes)]
    rng = np.random.default_rng(1)
    return [sv.Instance(shapes[index % meshes], sv.Material(), transform=turned(rng)) for index in range(count)]


def test_the_tree_is_built_in_the_order_of_space(by_compute):
    """Small meshes come in no order. In that the boxes of nodes have 9 times the volume of the scene in all, else 5."""
    with sv.RayTracer(by_compute, sv.Scene(*statics(400, 3, 400))) as tracer:
        tracer.trace((0, 0, 9), (0, 0, -1))
        flat = tracer.binder.tlas._traced.flat.tree
        nodes = np.array(flat.buffer.read())[: tree.NODE_BYTES * flat.slot_count].view(np.float32)
    corners = nodes.reshape(-1, 2, 2, 4)[1:, ..., :3].astype(float)
    volumes = np.prod(np.maximum(corners[:, :, 1] - corners[:, :, 0], 0), axis=-1)
    assert volumes.sum() < 6 * np.prod(np.ptp(corners, axis=(0, 1, 2)))


def posed():
    mesh = soup(20_000)
    moves = np.random.default_rng(1).normal(size=(1, *mesh.positions.shape))
    moving = sv.Mesh(mesh.positions, mesh.triangles, deformation=sv.Deformation(targets=moves))
    return [sv.Instance(moving, sv.Material(), morph_weights=[0.0])]


@pytest.mark.parametrize(
    ("made", "most"),
    [
        (lambda: statics(1, 20_000, 1), 81),
        (lambda: statics(500, 12, 500), 160),
        (lambda: statics(20, 10_000, 1), 82),
        (posed, 161),
    ],
    ids=["large", "small", "instanced", "posed"],
)
def test_bytes_of_trees_a_triangle(any_device, made, most):
    """With all that instances take, with a structure of the previous frame, and without what only builds take."""
    scene = sv.Scene(*made())
    scene.environment = sv.Sky()
    with sv.Device(rays="compute") as device, sv.Renderer(device, scene, SIZE) as renderer:
        for frame in range(5):
            for instance in scene.instances:
                if instance.morph_weights is not None:
                    instance.morph_weights = [0.1 * frame]
            renderer.render(CAMERA)
        device.wait_idle()
        triangles = sum(len(mesh.triangles) for mesh in {instance.mesh for instance in scene.instances})
        assert 0 < device.memory.bytes_by_use["trees"] < most * triangles


def test_meshes_have_trees_while_instances_are_outside(by_compute):
    """An instance that leaves the common tree, and one in its place that comes in, are hit as by a new tracer."""
    first, second = statics(2, 3000, 2)
    scene = sv.Scene(first, second)
    rng = np.random.default_rng(2)
    origins = 9 * rng.normal(size=(400, 3))
    rays = origins, 3 * rng.random((400, 3)) - origins

    def check(tracer, are_built):
        found = tracer.trace(*rays)
        with sv.RayTracer(by_compute, scene) as fresh:
            expected = fresh.trace(*rays)
        assert np.isfinite(expected["t"]).any()
        for name in ("t", "primitive", "barycentrics", "position", "normal"):
            np.testing.assert_array_equal(found[name], expected[name], name)
        built = [tree.built for tree in tracer.binder.assets.geometry.blases.values()]
        assert built == are_built

    with sv.RayTracer(by_compute, scene) as tracer:
        check(tracer, [False, False])
        first.transform = turned(rng)
        check(tracer, [True, False])
        moved = sv.Instance(first.mesh, first.material, transform=first.transform)
        scene.add(moved)
        scene.remove(first)
        tracer.trace(*rays)
        second.transform = turned(rng)
        check(tracer, [False, True])
        scene.remove(moved)
        check(tracer, [True])


BUGS = {
    "t is that of world space": Bug(
        "scene/trace_compute.glsl",
        "hit_in_object_space",
        "Hit hit = correct(flat_hit, slots, origin, direction); hit.t = flat_hit.t; return hit;",
    ),
    "a third of the instances is lost": Bug(
        "scene/trees/primitives.glsl", "write_slot", "if (number % 3u != 0u) { correct(number); }"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BUGS)
def test_a_seeded_bug_is_noticed(by_compute, name, monkeypatch):
    def check():
        tree._kernels.clear()
        try:
            test_pictures_are_those_of_two_levels(by_compute, sv.PathTracer, monkeypatch)
        finally:
            tree._kernels.clear()
            monkeypatch.undo()

    expect_noticed(BUGS[name], name, check)
