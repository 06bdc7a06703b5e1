"""The tree over lights: its nodes hold the lights below them, and it is built anew only when lights change."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights import light_tree
from solari_vk.bound.table import Table
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte

RECORD = np.dtype(
    [
        ("center", "f4", 3),
        ("half_size", "f4", 3),
        ("power", "f4"),
        ("child_count", "u4"),
        ("first", "u4"),
        ("parent", "u4"),
    ]
)


def random_lights(count, seed=1):
    random = np.random.default_rng(seed)
    middles = random.normal(scale=10, size=(count, 1, 3))
    return middles + random.random((count, 1, 3)) * [[[-1.0], [1.0]]], random.random(count) ** 8


def check_tree(nodes, leaves, bounds, powers):
    """Every light is in one leaf, and every node holds the bounds and the power of the lights below it."""
    below = {}

    def visit(node):
        count, first = int(nodes["child_count"][node]), int(nodes["first"][node])
        if not count:
            assert leaves[first] == node
            below[node] = [first]
            return
        assert 2 <= count <= 2**light_tree.HALVINGS
        below[node] = []
        for child in range(first, first + count):
            assert nodes["parent"][child] == node
            visit(child)
            below[node] += below[child]

    visit(0)
    assert sorted(below[0]) == list(range(len(powers)))
    for node, lights in below.items():
        low, high = bounds[lights, 0].min(axis=0), bounds[lights, 1].max(axis=0)
        np.testing.assert_allclose(nodes["center"][node], (low + high) / 2, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(nodes["half_size"][node], (high - low) / 2, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(nodes["power"][node], powers[lights].sum() / powers.sum(), rtol=1e-5, atol=1e-30)


@pytest.mark.parametrize("count", [1, 2, 9, 200])
def test_nodes_hold_the_lights_below_them(count):
    bounds, powers = random_lights(count)
    check_tree(*light_tree.light_tree(bounds, powers, RECORD), bounds, powers)


def test_no_lights_lights_at_one_place_and_extreme_powers():
    bounds, powers = np.ones((40, 2, 3)), np.geomspace(1e-290, 1e300, 40)
    check_tree(*light_tree.light_tree(bounds, powers, RECORD), bounds, powers)
    assert [len(part) for part in light_tree.light_tree(bounds[:0], np.zeros(0), RECORD)] == [0, 0]
    nodes, leaves = light_tree.light_tree(bounds, np.zeros(40), RECORD)
    assert len(set(leaves.tolist())) == 40
    assert not nodes["power"].any()


def test_neighbors_share_nodes():
    """The mean size of the lowest inner nodes is far below that of as many lights taken at random."""
    bounds, powers = random_lights(4000)
    nodes, _ = light_tree.light_tree(bounds, powers, RECORD)
    leaf = np.flatnonzero((nodes["child_count"] == 0) & (nodes["parent"] > 0))
    sizes = np.linalg.norm(nodes["half_size"][nodes["parent"][leaf]], axis=1)
    assert sizes.mean() < 0.3 * np.linalg.norm(nodes["half_size"][0])


def test_lights_that_move_or_change_their_power():
    """The tree follows: only nodes above moved lights change; the tree is built anew once lights are far away."""
    random = np.random.default_rng(4)
    bounds, powers = random_lights(200)
    ids, tree = np.arange(200, dtype=np.uint32), light_tree.LightTree(RECORD)
    assert len(tree.update(ids, bounds, powers)) == len(tree.nodes)
    leaves = tree.leaves
    assert not len(tree.update(ids, bounds, powers))
    for moved in (1, 3, 40):
        lights, before = random.choice(200, moved, replace=False), tree.nodes.copy()
        bounds = bounds.copy()
        bounds[lights] += random.normal(size=(moved, 1, 3))
        changed = tree.update(ids, bounds, powers)
        assert 0 < len(changed) <= 4 * moved
        assert set(np.flatnonzero(tree.nodes != before).tolist()) <= set(changed.tolist())
        check_tree(tree.nodes, tree.leaves, bounds, powers)
    powers = powers[::-1] ** 2
    tree.update(ids, bounds, powers)
    check_tree(tree.nodes, tree.leaves, bounds, powers)
    assert tree.leaves is leaves
    bounds = random.permutation(bounds)
    assert len(tree.update(ids, bounds, powers)) == len(tree.nodes)
    assert tree.leaves is not leaves
    check_tree(tree.nodes, tree.leaves, bounds, powers)


def test_the_tree_follows_the_lights_alone(bound, monkeypatch):
    """Adding and removing lights builds the tree anew. When a light moves, its row is uploaded, and its nodes."""
    quad = shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, 2))
    lamps = [sv.Instance(quad, lamp(x + 1.0), transform=(x, 0, 0)) for x in range(5)]
    sun = sv.DirectionalLight(direction=(0, -1, 0), illuminance=1)
    other = sv.Instance(quad, matte(0.5))
    binder = bound(*lamps, other, sun)
    builds = []
    build = light_tree.light_tree
    uploaded = {}
    find_runs = Table._runs

    def note(table):
        uploaded[table.name] = len(table.marked)
        return find_runs(table)

    monkeypatch.setattr(Table, "_runs", note)
    monkeypatch.setattr("solari_vk.bound.lights.light_tree.light_tree", lambda *a: (builds.append(1), build(*a))[1])

    def built():
        builds.clear()
        uploaded.clear()
        binder.update()
        lights, finite = binder.lights, len(binder.scene.instances) - 1
        leaves = lights.leaves.table.records[: finite + 1]
        assert (leaves["node"] == NO_INDEX).tolist() == [False] * finite + [True]
        half = np.array([[1, 0, 2]]) * ([[1]] * finite)
        bounds = np.stack([lights.positions[:finite] - half, lights.positions[:finite] + half], axis=1)
        check_tree(lights.leaves.tree.records, leaves["node"], bounds, lights.powers[:finite])
        total = leaves["by_power"]["probability"][:finite].sum(dtype=np.float64)
        assert lights.info.records[0]["tree_probability"] == pytest.approx(total)
        assert lights.info.records[0]["part_count"] == 2 * finite + 1
        return len(builds)

    assert built() == 1
    other.transform = (0, 5, 0)
    assert built() == 0
    assert "light_tree" not in uploaded
    lamps[2].transform = (0, 3, 0)
    assert built() == 0
    assert (uploaded["light_sources"], uploaded["light_tree"]) == (1, 2)
    lamps[1].material.emissive = (9.0, 9.0, 9.0)
    assert built() == 0
    sun.illuminance = 3.0
    assert built() == 0
    assert "light_tree" not in uploaded
    for edit in (binder.scene.remove, binder.scene.add):
        edit(lamps[0])
        assert built() == 1
    assert built() == 0
