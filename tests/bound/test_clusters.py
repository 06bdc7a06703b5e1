"""Clusters of triangles of emissive meshes: their boxes in poses, and the leaves of lights that are made of them."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights import clusters
from solari_vk.bound.lights.clusters import LARGEST, Clusters
from solari_vk.bound.spatial_order import memory_order, runs, spatial_order, z_order
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp
from solari_vk.scene.matrices import transform_points

JOINTS = 5


def soup(random, count, deformation=None):
    """Small triangles anywhere in a unit cube."""
    positions = random.random((count, 1, 3)) + 0.02 * random.random((count, 3, 3))
    return sv.Mesh(positions.reshape(-1, 3).astype(np.float32), deformation=deformation)


def areas(corners):
    """Of triangles (N, 3, 3)."""
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def in_order(mesh):
    corners = mesh.positions[mesh.triangles]
    return mesh.triangles[spatial_order(corners.min(axis=1), corners.max(axis=1))]


@pytest.mark.parametrize("count", [129, 256, 257, 1000, 4097])
def test_runs_are_what_the_points_are_halved_into(count):
    """Each run is on one side of the plane that halves the points of its parent: runs are disjoint boxes."""
    points = np.random.default_rng(count).random((count, 3)).astype(np.float32)
    points, (starts, sizes, halvings) = points[spatial_order(points)], runs(count, LARGEST)
    assert (np.cumsum(sizes) - sizes == starts).all()
    assert sizes.sum() == count
    assert len(starts) == 2**halvings
    assert LARGEST / 2 - 1 <= sizes.min() <= sizes.max() <= LARGEST
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    overlaps = ((low[:, None] < high) & (low < high[:, None])).all(axis=-1)
    assert overlaps.sum() == len(starts), "each overlaps itself alone"


def merged(mesh, places):
    positions = np.concatenate([mesh.positions + place for place in places]).astype(np.float32)
    triangles = [mesh.triangles + len(mesh.positions) * index for index in range(len(places))]
    return sv.Mesh(positions, np.concatenate(triangles))


def test_sparse_clusters_are_smaller(monkeypatch):
    """Surfaces have clusters of up to LARGEST triangles, however many they are; small lamps that are far apart have one
    for each triangle, unless they are very many."""
    random = np.random.default_rng(2)
    square, ball = shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, 1)), shapes.sphere(0.3, 12)
    wall = np.stack(np.meshgrid(np.arange(30), [0], np.arange(20)), axis=-1).reshape(-1, 3)
    turn, full = np.linalg.qr(random.normal(size=(3, 3)))[0], LARGEST / 2 - 1

    def sizes(mesh):
        order = in_order(mesh)
        made = Clusters(mesh, order, areas(mesh.positions[order]), np.ones(len(order)))
        assert made.sizes.sum() == len(order)
        assert made.shares.sum() == pytest.approx(1)
        assert (made.halvings == NO_INDEX) == (len(order) > 1 and (made.sizes == 1).all())
        return made.sizes

    assert sizes(square).tolist() == [2]
    assert sizes(shapes.box()).tolist() == [12]
    sphere = shapes.sphere(1.0, 64)
    assert sizes(sphere).min() > full
    assert sizes(sv.Mesh(sphere.positions @ turn, sphere.triangles)).min() > full
    assert sizes(merged(square, wall)).min() > full
    assert sizes(merged(ball, 6 * wall)).min() > 6
    assert sizes(merged(square, 20 * wall)).tolist() == [1] * 1200
    assert sizes(merged(square, [(0, 0, 0), (30, 0, 0)])).tolist() == [2, 2]
    monkeypatch.setattr(clusters, "MAX_CLUSTERS", 400)
    found = sizes(merged(square, 20 * wall))
    assert 100 < len(found) <= 200


@pytest.mark.parametrize("moved_by", ["nothing", "joints", "targets", "joints and targets"])
def test_boxes_hold_the_triangles_in_a_pose(moved_by):
    random = np.random.default_rng(3)
    count = 400
    joints = None
    weights = None
    targets = None
    if "joints" in moved_by:
        joints = np.repeat(random.integers(0, JOINTS, (count, 2)), 3, axis=0)
        weights = random.random((3 * count, 2)) * random.integers(0, 2, (3 * count, 2))
    if "targets" in moved_by:
        targets = 0.3 * random.normal(size=(2, 3 * count, 3))
    deformation = None
    if moved_by != "nothing":
        deformation = sv.Deformation(joints=joints, joint_weights=weights, targets=targets)
    mesh = soup(random, count, deformation)
    triangles = in_order(mesh)
    made = Clusters(mesh, triangles, np.ones(count), np.ones(count))
    assert len(made.starts) > 1
    transform = np.vstack([random.normal(size=(3, 4)), (0, 0, 0, 1)])
    pose = (
        random.normal(size=(JOINTS, 3, 4)) if "joints" in moved_by else None,
        np.array([0.7, -1.3]) if "targets" in moved_by else None,
    )
    positions = mesh.positions if deformation is None else deformation.pose(mesh.positions, None, None, *pose)[0]
    corners = transform_points(transform, positions)[triangles]
    boxes = made.boxes(transform, *pose)
    for box, start, size in zip(boxes, made.starts, made.sizes, strict=True):
        assert (corners[start : start + size] >= box[0] - 1e-5).all()
        assert (corners[start : start + size] <= box[1] + 1e-5).all()


def check_leaves(binder, meshes):
    """Each light's leaves have all its parts once, its power by their area, and boxes around their triangles."""
    binder.update()
    lights, tables = binder.lights, binder.lights.leaves
    leaves = tables.table.records[: tables.count]
    shares = leaves["by_power"]["probability"].astype(np.float64)
    assert lights.info.records[0]["leaf_count"] == tables.count
    assert shares.sum() == pytest.approx(1, rel=1e-5)
    for instance in meshes:
        light = lights.index(instance)
        source, mine = lights.sources.records[light], leaves[tables.leaves(light)]
        starts = mine["first_part"]
        assert source["first_leaf"] == tables.leaves(light).start
        assert (source["halvings"] == NO_INDEX) == (len(mine) == source["part_count"])
        assert (mine["light"] == light).all()
        assert (mine["part_count"] == np.diff(starts, append=len(instance.mesh.triangles))).all()
        nodes = tables.tree.records[mine["node"]]
        assert (nodes["first"] == source["first_leaf"] + np.arange(len(mine))).all()
        assert not nodes["child_count"].any()
        corners = transform_points(instance.transform, instance.mesh.positions)[in_order(instance.mesh)]
        low = np.minimum.reduceat(corners.min(axis=1), starts)
        high = np.maximum.reduceat(corners.max(axis=1), starts)
        np.testing.assert_allclose(nodes["center"], (low + high) / 2, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(nodes["half_size"], (high - low) / 2, rtol=1e-4, atol=1e-4)
        expected = np.add.reduceat(areas(corners), starts) / areas(corners).sum()
        finite = lights.powers[: len(lights.centers)]
        np.testing.assert_allclose(nodes["power"], finite[light] / finite.sum() * expected, rtol=1e-4)
        of_light = shares[tables.leaves(light)]
        np.testing.assert_allclose(of_light / of_light.sum(), expected, rtol=1e-4)


def test_leaves_follow_lights(bound):
    """Through added and removed lights, other transforms, emission and positions; a moved mesh keeps its tree."""
    random = np.random.default_rng(1)
    small = [sv.Instance(shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, 2)), lamp(x + 1.0)) for x in range(3)]
    mesh = shapes.sphere(1.0, 24)
    large = [sv.Instance(mesh, lamp(2.0)), sv.Instance(mesh, lamp(3.0)), sv.Instance(soup(random, 100), lamp(1.0))]
    sun = sv.DirectionalLight(direction=(0, -1, 0), illuminance=1)
    binder = bound(small[0], large[0], small[1], *large[1:], small[2], sun)
    check_leaves(binder, [*small, *large])
    nodes = binder.lights.leaves.table.records["node"].copy()
    large[0].transform = 0.9 * np.array([[0, 1, 0, 0.1], [-1, 0, 0, 1], [0, 0, 1, 0]])
    check_leaves(binder, [*small, *large])
    large[1].material.emissive = (9.0, 9.0, 9.0)
    check_leaves(binder, [*small, *large])
    assert (binder.lights.leaves.table.records["node"] == nodes).all()
    binder.scene.remove(small[0])
    check_leaves(binder, [*small[1:], *large])
    mesh.positions = mesh.positions[::-1] * (1, 2, 3)
    check_leaves(binder, [*small[1:], *large])
    mesh.triangles = mesh.triangles[:90]
    check_leaves(binder, [*small[1:], *large])
    binder.scene.remove(large[0])
    binder.scene.add(small[0])
    check_leaves(binder, [*small, *large[1:]])


# ---- the order of clusters: a permutation that keeps neighbors together, for any points ----


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "points",
    [
        *(RNG.normal(size=(count, 3)) for count in (0, 1, 2, 3, 5, 16, 17, 4097)),
        np.zeros((50, 3)),
        np.tile([[0, 0, 1], [1e30, 0, 0]], (25, 1)),
    ],
)
def test_it_is_a_permutation_also_of_points_that_coincide(points):
    np.testing.assert_array_equal(np.sort(spatial_order(points)), np.arange(len(points)))


def test_neighbors_stay_together():
    points = RNG.random((20_000, 3))
    ideal = (16 / len(points)) ** (1 / 3)  # the side of a cube that holds sixteen points on average
    runs = points[spatial_order(points)].reshape(-1, 16, 3)
    assert np.ptp(runs, axis=1).max(axis=1).mean() < 2 * ideal


def test_graphics_cards_get_boxes_along_a_z_order_curve():
    """Sorting ten million triangles by halves would take most of a minute, of which only software devices gain."""
    x, y, z = np.mgrid[:8, :8, :8].reshape(3, -1).astype(np.float32)
    low = np.stack([x, y, z], axis=1)
    places = [
        sum((int(corner[axis]) >> bit & 1) << 3 * bit + axis for axis in range(3) for bit in range(3)) for corner in low
    ]
    np.testing.assert_array_equal(memory_order("discrete gpu", low, low + 1), np.argsort(places))
    np.testing.assert_array_equal(memory_order("cpu", low, low + 1), spatial_order(low, low + 1))
    low[7] = np.nan, np.inf, -np.inf
    for points in (low, np.zeros((50, 3)), np.full((3, 3), -1e38), np.zeros((0, 3))):
        np.testing.assert_array_equal(np.sort(z_order(points, points)), np.arange(len(points)))


def test_boxes_are_halved_where_the_halves_are_small():
    """Bars along x, 100 times as long as wide, whose centers spread most along x: halves along x would overlap."""
    centers, half_sizes = RNG.random((1000, 3)) * (3, 2, 1), np.array([50, 0.5, 0.5])
    ordered = centers[spatial_order(centers - half_sizes, centers + half_sizes)]
    assert ordered[:500, 1].max() <= ordered[500:, 1].min()


def test_the_larger_half_comes_first():
    """As in Mesa's builder."""
    points = np.array([[0, 0, 0], [9, 0, 0], [1, 0, 0]])
    assert sorted(spatial_order(points)[:2]) == [0, 2]


def test_halves_are_apart():
    points = RNG.random((1000, 3)) * (3, 1, 1)
    ordered = points[spatial_order(points)]
    assert ordered[:500, 0].max() <= ordered[500:, 0].min()
