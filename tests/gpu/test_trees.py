"""Trees that compute shaders build: each primitive is in one leaf, boxes contain, and no tree is too high."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from support.seeded_bugs import Bug, expect_noticed

import solari_vk as sv
from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.trees import tree as tree_module
from solari_vk.gpu.trees.refits import TreeRefits
from solari_vk.gpu.trees.tree import INSTANCE_BYTES, NODE_BYTES, MeshTree, SceneBuild, SceneTree, build_meshes

LEAF = 1 << 31
LEAF_FIRST = (1 << 28) - 1
MAX_HEIGHT = 48
NODE_COST = 1.2


def half_areas(boxes):
    size = np.maximum(boxes[..., 1, :] - boxes[..., 0, :], 0)
    return size[..., 0] * size[..., 1] + size[..., 1] * size[..., 2] + size[..., 2] * size[..., 0]


@contextmanager
def mesh_tree(device, corners):
    """A tree over corners (N, 3, 3), which are in spatial order; not built yet."""
    positions = np.ascontiguousarray(corners.reshape(-1, 3), np.float32)
    indices = np.arange(len(positions), dtype=np.uint32)
    buffers = [device.buffer(array.nbytes, "mesh") for array in (positions, indices)]
    for buffer, array in zip(buffers, (positions, indices), strict=True):
        buffer.upload(array)
    tree = MeshTree(
        device, TriangleGeometry(buffers[0].address, len(positions), len(corners), buffers[1].address), "test"
    )
    yield tree
    for owned in (*buffers, tree):
        owned.destroy()


def built(device, corners):
    """The nodes and the triangles of the tree over corners (N, 3, 3), which are in spatial order."""
    with mesh_tree(device, corners) as tree:
        build_meshes(device, [tree])
        return read(tree)


def read(tree):
    """Its nodes and triangles."""
    data = np.array(tree.buffer.read())
    end = NODE_BYTES * tree.slot_count
    return data[:end].view(np.float32).reshape(-1, 4, 4), data[end:].view(np.float32).reshape(-1, 3, 4)


def walk(nodes, triangles):
    """The numbers of the triangles in leaves, the height, and the cost of the surface area heuristic. Fails where a box
    doesn't contain what is below it, and where a tree is too high."""
    references = nodes[..., 3].view(np.uint32).astype(np.int64)
    numbers = triangles[:, 0, 3].view(np.uint32)
    found, height, cost = [], 0, 0.0
    level, boxes = references[:1, 0], nodes[:1, :2, :3]
    while level.any():
        assert height <= MAX_HEIGHT
        areas = half_areas(boxes.astype(float))
        is_leaf = level & LEAF != 0
        counts = (level[is_leaf] >> 28 & 7) + 1
        places = np.repeat((level[is_leaf] & LEAF_FIRST) - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        inside, around = triangles[places, :, :3], np.repeat(boxes[is_leaf], counts, axis=0)[:, :, None]
        outside = (inside < around[:, 0]) | (inside > around[:, 1])
        assert not outside[np.isfinite(inside).all(axis=(1, 2))].any()
        found += numbers[places].tolist()
        slots = level[~is_leaf]
        assert (slots < len(nodes)).all()
        cost += (areas[is_leaf] * counts).sum() + NODE_COST * areas[~is_leaf].sum()
        children, around = nodes[slots, :, :3].reshape(-1, 2, 2, 3), boxes[~is_leaf][:, None]
        assert (children[:, :, 0] >= around[:, :, 0]).all()
        assert (children[:, :, 1] <= around[:, :, 1]).all()
        level, boxes = references[slots, ::2].reshape(-1), children.reshape(-1, 2, 3)
        height += 1
    return found, height - 1, cost / max(half_areas(nodes[0, :2, :3].astype(float)), 1e-30)


def soup(kind, count):
    rng = np.random.default_rng(count)
    centers = rng.random((count, 1, 3))
    corners = centers + 0.02 * rng.normal(size=(count, 3, 3))
    if kind == "equal":
        corners[:] = corners[0]
    elif kind == "points":
        corners = np.repeat(centers, 3, axis=1)
    elif kind == "slivers":
        corners[:, 1] = corners[:, 0] + 1e3 * (corners[:, 1] - corners[:, 0])
        corners[:, 2] = corners[:, 0] + 1e-3 * (corners[:, 2] - corners[:, 0])
    elif kind == "concentric":
        corners = centers[:1] + (corners - corners.mean(axis=1, keepdims=True))
    elif kind == "shrinking":  # each merges with all smaller ones, which would make a tree as high as they are many
        corners = corners[:1] * 0.9 ** np.arange(count)[:, None, None]
    elif kind == "line":
        corners[..., 1:] *= 1e-6
    corners = corners.astype(np.float32)
    return corners[spatial_order(corners.min(axis=1), corners.max(axis=1))]


KINDS = ["plain", "equal", "points", "slivers", "line", "concentric", "shrinking"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 2, 3, 255, 257, 3000])
def test_each_triangle_is_in_one_leaf(device, kind, count):
    found, _, _ = walk(*built(device, soup(kind, count)))
    assert sorted(found) == list(range(count))


@contextmanager
def halvings(left, stage):
    """Few clusters of small chunks, so that small trees are built by many workgroups in many stages."""
    usual = tree_module.LEFT_HALVINGS, tree_module.STAGE_HALVINGS
    tree_module.LEFT_HALVINGS, tree_module.STAGE_HALVINGS = left, stage
    try:
        yield
    finally:
        tree_module.LEFT_HALVINGS, tree_module.STAGE_HALVINGS = usual


@given(
    st.sampled_from(KINDS), st.integers(1, 4000), st.integers(0, 8), st.integers(1, 6), st.sampled_from([0, 0.1, 0.99])
)
@settings(max_examples=60)
def test_trees_of_many_chunks(device, kind, count, left, stage, lost):
    """Each hittable triangle is in one leaf, and equal inputs give equal bits, however many workgroups build a tree."""
    corners = soup(kind, count)
    is_lost = np.random.default_rng(count).random(count) < lost
    corners[is_lost, 2, 1] = np.nan
    with halvings(left, stage):
        nodes, triangles = built(device, corners)
        again = built(device, corners)
    found, height, cost = walk(nodes, triangles)
    assert sorted(found) == np.flatnonzero(~is_lost).tolist()
    assert walk(*again) == (found, height, cost)
    event(f"height {height}")


def test_small_and_large_trees_are_built_together(device):
    """Their workgroups stand in the same dispatches."""
    meshes = [soup("plain", count) for count in (40, 2000, 1, 700, 3000, 5)]
    positions, indices = (device.buffer(36 * sum(map(len, meshes)), "meshes") for _ in range(2))
    positions.upload(np.concatenate(meshes))
    indices.upload(np.concatenate([np.arange(3 * len(mesh), dtype=np.uint32) for mesh in meshes]))
    trees, at = [], 0
    for mesh in meshes:
        geometry = TriangleGeometry(positions.address + 36 * at, 3 * len(mesh), len(mesh), indices.address + 12 * at)
        trees.append(MeshTree(device, geometry, "test"))
        at += len(mesh)
    with halvings(2, 3):
        build_meshes(device, trees)
    for tree, mesh in zip(trees, meshes, strict=True):
        assert sorted(walk(*read(tree))[0]) == list(range(len(mesh)))
        tree.destroy()
    for buffer in (positions, indices):
        buffer.destroy()


def test_what_no_ray_can_hit_is_in_no_leaf(device):
    corners = soup("plain", 500)
    corners[::3, 1, 2] = np.nan
    corners[1::3, 0, 0] = np.inf
    found, _, _ = walk(*built(device, corners))
    assert sorted(found) == list(range(2, 500, 3))
    assert walk(*built(device, np.full((4, 3, 3), np.nan, np.float32)))[0] == []


@pytest.mark.parametrize("kind", ["equal", "points", "slivers", "line", "concentric"])
def test_hits_of_unusual_meshes_are_those_of_queries(any_device, kind):
    """Of triangles in one place any may be hit, at the same distance. Lavapipe's queries miss some of a thin line."""
    query, compute = distances(soup(kind, 2000), 300)
    assert (compute <= query).all()
    assert kind == "line" or (compute == query).all()


@pytest.mark.slow
def test_a_million_triangles_in_one_place(any_device):
    query, compute = distances(np.repeat(soup("plain", 1), 1_000_000, axis=0), 20)
    np.testing.assert_array_equal(query, compute)


@pytest.mark.slow
def test_ten_million_triangles(device):
    """Along a diagonal, so that no sorting takes longer than the build."""
    rng = np.random.default_rng(5)
    centers = np.sort(rng.random((10_000_000, 1, 3), np.float32), axis=0)
    found, _, _ = walk(*built(device, centers + np.float32(1e-6) * rng.random((10_000_000, 3, 3), np.float32)))
    assert (np.bincount(found, minlength=10_000_000) == 1).all()


def distances(corners, count):
    """Of the hits of rays to the centers of random triangles, by queries and by compute."""
    rng = np.random.default_rng(1)
    aims = corners[rng.integers(0, len(corners), count)].mean(axis=1)
    origins = aims + rng.normal(size=(count, 3))
    mesh = sv.Mesh(*indexed(corners))
    found = []
    for way in ("query", "compute"):
        scene = sv.Scene(sv.Instance(mesh=mesh, material=sv.Material()))
        with sv.Device(rays=way) as device, sv.RayTracer(device, scene) as tracer:
            found.append(tracer.trace(origins, aims - origins)["t"])
    return found


@contextmanager
def scene_tree(device, places, address, steps=0):
    """A tree over instances of a mesh's tree, a tenth as large, at places (N, 3) in spatial order. All have row 0.
    steps: that have improved it."""
    records = np.zeros(len(places), INSTANCE_DTYPE)
    records["transform"][:, :, :3] = 0.1 * np.eye(3)
    records["transform"][:, :, 3] = places
    records["custom_index_and_mask"] = 0xFF << 24
    records["blas_address"] = address
    buffer, scene = device.buffer(records.nbytes, "records"), SceneTree(device, len(places))
    buffer.upload(records)
    build = SceneBuild(scene, buffer.address, len(places))
    build.submit()
    for _ in range(steps):
        device.wait_idle()
        build.improve()
    yield scene
    for owned in (build, scene, buffer):
        owned.destroy()


def walk_instances(device, count, steps):
    """The cost of a tree, each of whose instances is in one leaf."""
    mesh = soup("plain", 10)
    places = np.random.default_rng(3).random((count, 3)).astype(np.float32)
    places = places[spatial_order(places)]
    with mesh_tree(device, mesh) as tree:
        build_meshes(device, [tree])
        with scene_tree(device, places, tree.address, steps) as scene:
            data = np.array(scene.buffer.read())
    begin = NODE_BYTES * scene.slot_count
    leaves = data[begin : begin + INSTANCE_BYTES * count].view(np.float32).reshape(-1, 20)
    found = -leaves[:, 3:12:4] * 0.1  # object from world is a scale by 10
    low, high = (0.1 * getattr(mesh, end)(axis=(0, 1)) + found for end in ("min", "max"))
    inside = np.zeros((count, 3, 4), np.float32)
    inside[:, :, :3] = np.stack([low, high, low], axis=1)
    inside[:, 0, 3] = np.arange(count, dtype=np.uint32).view(np.float32)
    numbers, _, cost = walk(data[: NODE_BYTES * scene.slot_count].view(np.float32).reshape(-1, 4, 4), inside)
    assert sorted(numbers) == list(range(count))
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(places, axis=0), atol=1e-6)
    return cost


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 600, 20_000, 40_000])
def test_each_instance_is_in_one_leaf(device, count):
    """Also when the tree is improved, which is done for up to 32,768 instances."""
    built, improved, again = (walk_instances(device, count, steps) for steps in (0, 10, 10))
    assert improved == again
    assert improved <= built
    assert improved < 0.98 * built or not 600 <= count <= 20_000


@pytest.mark.slow
def test_a_million_instances(any_device):
    rng = np.random.default_rng(3)
    places = 40 * rng.random((1_000_000, 3)).astype(np.float32)
    places = places[spatial_order(places)]
    origins = rng.normal(size=(40, 3)) * 60
    directions = 40 * rng.random((40, 3)) - origins
    scene = sv.Scene(sv.Instance(mesh=sv.shapes.box(), material=sv.Material()))
    with sv.Device(rays="compute") as device, sv.RayTracer(device, scene) as tracer:
        tracer.trace(origins, directions)
        [tree] = tracer.binder.assets.geometry.blases.values()
        build_meshes(device, [tree])
        with scene_tree(device, places, tree.address) as many:
            tracer.binder.tlas._addresses.upload(np.array([many.address] * 2, np.uint64))
            found = tracer.trace(origins, directions)["t"]
        half = 0.1 * np.abs(sv.shapes.box().positions).max(axis=0)
    for t, origin, direction in zip(found, origins, directions, strict=True):
        ends = (places[None] + np.stack([-half, half])[:, None] - origin) / direction
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        assert t == pytest.approx(enter[(enter <= leave) & (enter > 0)].min(initial=np.inf), rel=1e-5)


@pytest.mark.parametrize("instances", [0, 1])
def test_rays_pass_scenes_without_triangles(any_device, instances):
    scene = sv.Scene(*[sv.Instance(mesh=sv.shapes.box(), material=sv.Material(), visible=False)] * instances)
    with sv.Device(rays="compute") as device, sv.RayTracer(device, scene) as tracer:
        assert np.isinf(tracer.trace((0, 0, 5), (0, 0, -1))["t"]).all()


def test_equal_inputs_give_equal_trees(device):
    corners = soup("plain", 3000)
    first, second = (built(device, corners) for _ in range(2))
    used = walk(*first)
    assert used == walk(*second)
    np.testing.assert_array_equal(first[1], second[1])


@pytest.mark.parametrize("count", [1, 3, 5, 700, 3000])
def test_refits_hold_all_triangles(device, count):
    """In place and from another tree, after triangles have moved, been no numbers, and become numbers again."""
    corners = soup("plain", count)
    rng = np.random.default_rng(4)
    lost = corners.copy()
    lost[::7, 1] = np.nan
    poses = [lost, corners, corners + rng.normal(0, 0.3, corners.shape), -3 * corners]
    positions, indices = (device.buffer(size, "mesh") for size in (corners.nbytes, 4 * corners.size // 3))
    indices.upload(np.arange(corners.size // 3, dtype=np.uint32))
    geometry = TriangleGeometry(positions.address, corners.size // 3, len(corners), indices.address)
    trees = [MeshTree(device, geometry, "test", moves=True) for _ in range(2)]
    positions.upload(lost)
    build_meshes(device, trees[:1])
    for number, pose in enumerate(poses * 2):
        positions.upload(pose.astype(np.float32))
        tree, source = trees[number // 2 % 2], trees[(number + 1) // 4 % 2]
        refits = TreeRefits(device, [(tree, source)])
        device.start(refits.record)
        refits.destroy()
        nodes, triangles = read(tree)
        found, _, _ = walk(nodes, triangles)
        assert sorted(found) == list(range(len(corners)))
        np.testing.assert_array_equal(triangles[:, :, :3], pose.astype(np.float32)[triangles[:, 0, 3].view(np.uint32)])
    for owned in (*trees, positions, indices):
        owned.destroy()


@pytest.mark.parametrize(("left", "stage"), [(6, 5), (3, 3)])
@pytest.mark.parametrize("count", [1, 2, 700, 3000])
def test_triangles_that_moved_are_sorted(device, count, left, stage):
    """By one workgroup, and by many."""
    corners = soup("plain", count)
    _, _, cost = walk(*built(device, corners))
    shuffled = np.random.default_rng(1).permutation(corners)
    with halvings(left, stage), mesh_tree(device, shuffled) as tree:
        build_meshes(device, [tree])  # which leaves the box around all
        build_meshes(device, [tree], moved=True)
        found, _, of_sorted = walk(*read(tree))
    assert sorted(found) == list(range(count))
    assert of_sorted <= 1.05 * cost


@pytest.mark.parametrize("goes_on", [False, True])
def test_trees_that_refits_made_bad_are_built_anew(any_device, goes_on):
    """All triangles change places, and the mesh stands still then or goes on to move."""
    corners = soup("plain", 2000)
    moves = np.random.default_rng(1).permutation(corners) - corners
    mesh = sv.Mesh(*indexed(corners), deformation=sv.Deformation(targets=moves.reshape(1, -1, 3)))
    instance = sv.Instance(mesh=mesh, material=sv.Material(), morph_weights=[0.0])
    costs = []
    with sv.Device(rays="compute") as device, sv.RayTracer(device, sv.Scene(instance)) as tracer:
        for number in range(8):
            instance.morph_weights = [0.01 * number if number < 3 else 1 + goes_on * 0.01 * number]
            tracer.trace((0, 0, 5), (0, 0, -1))
            posed, _ = tracer.binder.records._uses[instance][:2]
            found, _, cost = walk(*read(posed.blases[posed.side]))
            assert sorted(found) == list(range(2000))
            costs.append(cost)
        moved = (corners + moves * instance.morph_weights[0]).astype(np.float32)
        _, _, fresh = walk(*built(device, moved[spatial_order(moved.min(axis=1), moved.max(axis=1))]))
    assert max(costs[3:5]) > 3 * fresh
    assert max(costs[6:]) <= 1.5 * fresh


@pytest.mark.parametrize("name", ["buffer tree statue", "buffer that builds trees of statue"])
def test_exhausted_memory_names_trees_and_loses_nothing(any_device, monkeypatch, name):
    box, statue = (
        sv.Instance(mesh=mesh, material=sv.Material(name="paint"))
        for mesh in (sv.shapes.box(), sv.Mesh(*indexed(soup("plain", 90_000)), name="statue"))
    )
    rays = np.random.default_rng(1).normal(size=(2, 200, 3))
    with sv.Device(rays="compute") as device, sv.RayTracer(device, scene := sv.Scene(box)) as tracer:
        alone = tracer.trace(*rays)["t"]
        # Of two instances, which aren't in the common tree.
        pair = statue, sv.Instance(mesh=statue.mesh, material=statue.material, transform=np.diag([2, 2, 2, 1.0]))
        for one in pair:
            scene.add(one)
        memory = device.memory
        allocate = memory.allocate
        with monkeypatch.context() as patch:

            def fail(requirements, asked, **options):
                if asked.startswith(name):
                    memory.on_shortage()
                    device.await_idle()
                    memory._trim()
                    patch.setattr(memory, "_heap_sizes", list(memory._heap_reserved))
                return allocate(requirements, asked, **options)

            patch.setattr(memory, "allocate", fail)
            with pytest.raises(DeviceError, match=rf"^{name}: .*trees hold [\d,]+\).*simplify large meshes") as error:
                tracer.trace(*rays)
            assert "\n" not in str(error.value)
        both = tracer.trace(*rays)["t"]
        for one in pair:
            scene.remove(one)
        np.testing.assert_array_equal(tracer.trace(*rays)["t"], alone)
        assert (both <= alone).all()
        assert (both < alone).any()


def test_a_mesh_of_too_many_triangles_is_refused(device):
    count = tree_module.MAX_PRIMITIVES + 1
    with pytest.raises(SolariError, match=r"^statue: a tree holds 134,217,728 .*, not 134,217,729: split it$"):
        MeshTree(device, TriangleGeometry(16, 3, count, 16), "statue")


def indexed(corners):
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def binned_cost(corners):
    """The cost of a tree that is split where the surface area heuristic says, among 16 planes an axis: Wald, "On fast
    Construction of SAH-based Bounding Volume Hierarchies" (2007)."""
    boxes = np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1).astype(float)

    def cost_of(members):
        own = np.stack([members[:, 0].min(axis=0), members[:, 1].max(axis=0)])
        area = half_areas(own)
        as_leaf = area * len(members)
        if len(members) <= 1:
            return as_leaf
        centers = members.sum(axis=1)
        best, parts = np.inf, None
        for axis in range(3):
            low, high = centers[:, axis].min(), centers[:, axis].max()
            bins = np.minimum((16 * (centers[:, axis] - low) / max(high - low, 1e-30)).astype(int), 15)
            for plane in range(1, 16):
                left = bins < plane
                if left.all() or not left.any():
                    continue
                sides = [members[left], members[~left]]
                ends = [np.stack([side[:, 0].min(axis=0), side[:, 1].max(axis=0)]) for side in sides]
                split = sum(half_areas(end) * len(side) for end, side in zip(ends, sides, strict=True))
                if split < best:
                    best, parts = split, sides
        if parts is None:
            parts = [members[: len(members) // 2], members[len(members) // 2 :]]
        as_node = NODE_COST * area + sum(map(cost_of, parts))
        return min(as_leaf, as_node) if len(members) <= 4 else as_node

    whole = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    return cost_of(boxes) / half_areas(whole)


@pytest.mark.parametrize(("left", "stage"), [(6, 5), (2, 3)])
@pytest.mark.parametrize("kind", ["plain", "slivers", "torus"])
def test_trees_are_as_good_as_binned_ones(device, kind, left, stage):
    """In one chunk and in many."""
    corners = soup(kind, 1500)
    if kind == "torus":
        mesh = sv.shapes.torus(1.0, 0.3)
        corners = mesh.positions[mesh.triangles]
        corners = corners[spatial_order(corners.min(axis=1), corners.max(axis=1))]
    with halvings(left, stage):
        _, _, cost = walk(*built(device, corners))
    assert cost <= 1.15 * binned_cost(corners)


def test_trees_that_stay_are_improved(device, monkeypatch):
    corners = soup("plain", 3000)
    found, height, improved = walk(*built(device, corners))
    monkeypatch.setattr(tree_module, "IMPROVING_ROUNDS", 0)
    assert sorted(found) == list(range(3000))
    assert height <= MAX_HEIGHT
    assert improved < 0.96 * walk(*built(device, corners))[2]


BUGS = {
    "a box too small by one ulp": Bug(
        "scene/trees/clusters.glsl",
        "merge",
        "uint node = correct(first, second); vec3 high = build.clusters.at[node].high; "
        "build.clusters.at[node].high = uintBitsToFloat(floatBitsToUint(high) - 1u); return node;",
    ),
    "a leaf of one triangle less": Bug(
        "scene/trees/build.comp", "reference_of", "place.primitive++; return correct(child, place);"
    ),
    "a tree that is too high": Bug(
        "scene/trees/clusters.glsl", "nearest_cluster", "return correct(list, count, place, 64u);"
    ),
    "a child is skipped": Bug("scene/trees/refit.comp", "join", "return a;"),
    "a box that stays": Bug(
        "scene/trees/refit.comp", "set_box", "if ((slot & 7u) != 5u) { correct(slot, is_second, child); }"
    ),
    "the first of two children goes on": Bug(
        "scene/trees/refit.comp", "other_child", "correct(slot, is_second, own_cost, other); return true;"
    ),
    "codes are sorted by half of their digits": Bug(
        "scene/trees/sort.glsl", "digit_of", "return correct(key, shift % 15u);"
    ),
    "more leaves than there is room for": Bug(
        "scene/trees/clusters.glsl", "has_too_many_leaves", "return attempt + 1u < LAST_ATTEMPT && correct(count);"
    ),
    "boxes that stay where instances moved": Bug(
        "scene/trees/reinsertion.glsl", "fit_above", "if (cluster % 5u != 0u) { correct(cluster); }"
    ),
    "no subtree finds a better place": Bug(
        "scene/trees/reinsertion.glsl", "find_target", "correct(moved, gain); return NO_TARGET;"
    ),
    "parts of leaves move": Bug("scene/trees/reinsertion.glsl", "is_within_leaf", "return false;"),
    "the nearest is never found": Bug("scene/trees/clusters.glsl", "nearest_cluster", "return place;"),
}


def check_with_new_kernel(device):
    tree_module._kernels.clear()
    try:
        test_each_triangle_is_in_one_leaf(device, "plain", 257)
        test_each_triangle_is_in_one_leaf(device, "slivers", 257)
        test_each_triangle_is_in_one_leaf(device, "shrinking", 3000)
        test_trees_are_as_good_as_binned_ones(device, "plain", 2, 3)
        test_each_instance_is_in_one_leaf(device, 600)
        with pytest.MonkeyPatch.context() as patch:
            test_trees_that_stay_are_improved(device, patch)
        test_refits_hold_all_triangles(device, 700)
        test_triangles_that_moved_are_sorted(device, 700, 3, 3)
    finally:
        tree_module._kernels.clear()


@pytest.mark.slow
@pytest.mark.parametrize("name", BUGS)
def test_a_seeded_bug_is_noticed(device, name):
    expect_noticed(BUGS[name], name, check_with_new_kernel, device)
