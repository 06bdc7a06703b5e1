"""Trees over the lights of a scene, by which a surface chooses those that light it most.

What it calls a light may be a cluster of triangles of an emissive mesh. The triangles of a cluster are chosen by the
light that they send out, not by how near they are to the surface.

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018), without the
splitting; Pharr, Jakob and Humphreys, "Physically Based Rendering" (4th edition, 2023), section 12.6.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
# Times that the lights of a node are halved, so that it has up to 8 children. A choice among several at once is better
# than a row of choices between two, and takes no more time.
HALVINGS = 3
# A tree is built anew when lights have moved so far that the sum of its nodes' sizes has grown by this factor.
MAX_GROWTH = 1.5
# In which tree a light is: of those nearby, or at infinity, where all portals, which have a tree of their own, are one.
# The nodes at infinity are the last ones of the table, by which shaders know them.
NEAR, BEHIND_PORTALS, FAR = range(3)
EVERYWHERE = np.array([[-1.0] * 3, [1.0] * 3])  # the bounds of all directions


class LightTree:
    """The tree of a scene's lights. record: the shaders' struct LightNode."""

    def __init__(self, record: np.dtype[Any]) -> None:
        self.nodes: NDArray[Any] = np.zeros(0, record)
        """Root first, siblings side by side."""
        self.leaves: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """Each light's leaf (N,). Each tree that is built anew has a new array."""
        self._ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self._new_size = 0.0  # the sum of the nodes' sizes when the tree was built

    def update(self, ids: NDArray[np.uint32], bounds: Floats, powers: Floats) -> NDArray[np.uint32]:
        """Follow lights (N,) that move or change their power; returns the indices of all nodes that have changed.

        ids: numbers that stay with the lights; the tree is built anew when they change. bounds, powers: as those of
        `light_tree`.
        """
        if np.array_equal(ids, self._ids):
            leaves = self.nodes[self.leaves]
            leaves["center"], leaves["half_size"] = _box(bounds[:, 0], bounds[:, 1])
            leaves["power"] = _shares(powers)
            changed = self.leaves[leaves != self.nodes[self.leaves]]
            self.nodes[self.leaves] = leaves
            changed = _refit(self.nodes, changed)
            if self._size() <= MAX_GROWTH * self._new_size:
                return changed
        self.nodes, self.leaves = light_tree(bounds, powers, self.nodes.dtype)
        self._ids = ids
        self._new_size = self._size()
        return np.arange(len(self.nodes), dtype=np.uint32)

    def _size(self) -> float:
        return float(self.nodes["half_size"].sum(dtype=np.float64))


class LightForest:
    """The trees of a scene's lights in one table. record: the shaders' struct LightNode."""

    def __init__(self, record: np.dtype[Any]) -> None:
        self.nodes: NDArray[Any] = np.zeros(0, record)
        """Tree by tree, in the order of NEAR, BEHIND_PORTALS and FAR."""
        self.leaves: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """Each light's leaf (N,). Trees that are built anew have a new array."""
        self.roots = [NO_INDEX] * 3
        """Of each tree, NO_INDEX for one without lights."""
        self._trees = [LightTree(record) for _ in (NEAR, BEHIND_PORTALS, FAR)]
        self._groups: NDArray[np.uint8] = np.zeros(0, np.uint8)

    @property
    def has_choice(self) -> bool:
        """Whether there is more than one leaf."""
        return len(self.leaves) > 1

    def update(
        self, ids: NDArray[np.uint32], bounds: Floats, powers: Floats, groups: NDArray[np.uint8], through_portals: float
    ) -> NDArray[np.uint32]:
        """Follow lights (N,), as `LightTree.update` does. groups: the tree of each. bounds: of those at infinity,
        around directions to them. powers: comparable within a tree. through_portals: of all portals, at infinity.
        """
        rows = [np.flatnonzero(groups == group) for group in (NEAR, BEHIND_PORTALS, FAR)]
        before = [tree.leaves for tree in self._trees]
        given = [(ids[own], bounds[own], powers[own]) for own in rows]
        if len(rows[BEHIND_PORTALS]):
            additions = np.zeros(1, np.uint32), EVERYWHERE[None], np.array([through_portals])
            given[FAR] = tuple(map(np.append, given[FAR], additions, (0, 0, 0)))  # type: ignore[arg-type,assignment]
        changed = [tree.update(*of_tree) for tree, of_tree in zip(self._trees, given, strict=True)]
        starts = np.cumsum([0, *(len(tree.nodes) for tree in self._trees)])
        built = any(tree.leaves is not leaves for tree, leaves in zip(self._trees, before, strict=True))
        if built or not np.array_equal(groups, self._groups):
            self._groups = groups
            self._join(rows, starts)
            return np.arange(len(self.nodes), dtype=np.uint32)
        for tree, own, start in zip(self._trees, changed, starts[:-1], strict=True):
            for field in ("center", "half_size", "power"):
                self.nodes[field][start + own] = tree.nodes[field][own]
        return np.concatenate([own + np.uint32(start) for own, start in zip(changed, starts[:-1], strict=True)])

    def _join(self, rows: list[Indices], starts: Indices) -> None:
        self.nodes = np.concatenate([tree.nodes for tree in self._trees])
        self.leaves = np.zeros(sum(map(len, rows)), np.uint32)
        self.roots = [
            int(start) if len(tree.nodes) else NO_INDEX for tree, start in zip(self._trees, starts, strict=False)
        ]
        for tree, own, start in zip(self._trees, rows, starts[:-1], strict=True):
            nodes = self.nodes[start : start + len(tree.nodes)]
            nodes["first"] += np.uint32(start)
            nodes["parent"] += np.uint32(start)
            leaves = tree.leaves[: len(own)]
            nodes["first"][leaves] = own
            self.leaves[own] = leaves + np.uint32(start)
        if len(rows[BEHIND_PORTALS]):
            portals = starts[FAR] + self._trees[FAR].leaves[-1]
            self.nodes["child_count"][portals] = 1
            self.nodes["first"][portals] = self.roots[BEHIND_PORTALS]
            self.nodes["parent"][self.roots[BEHIND_PORTALS]] = portals


def _refit(nodes: NDArray[Any], changed: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Compute all nodes above changed ones from their children, and return the indices of both."""
    found = [changed]
    while True:
        # Level by level; the root, node 0, has no parent.
        changed = np.unique(nodes["parent"][changed[changed > 0]])
        if not len(changed):
            return np.unique(np.concatenate(found))
        nodes[changed] = _joined(nodes, changed)
        found.append(changed)


def _joined(nodes: NDArray[Any], parents: NDArray[Any]) -> NDArray[Any]:
    """The records of these nodes (N,), computed from their children."""
    # Nodes with fewer children than others repeat their first one, which changes no bounds.
    present = np.arange(2**HALVINGS) < nodes["child_count"][parents, None]
    children = nodes[nodes["first"][parents, None] + np.arange(2**HALVINGS) * present]
    center = children["center"].astype(np.float64)
    joined: NDArray[Any] = nodes[parents]
    low, high = (center - children["half_size"]).min(axis=1), (center + children["half_size"]).max(axis=1)
    joined["center"], joined["half_size"] = _box(low, high)
    joined["power"] = (children["power"] * present).sum(axis=1)
    return joined


def _box(low: Floats, high: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centers and half sizes that hold all of these bounds, since no light is sent below what they hold."""
    center = ((low + high) / 2).astype(np.float32)
    exact = np.maximum(high - center, center - low)
    half_size = exact.astype(np.float32)
    return center, np.where(half_size < exact, np.nextafter(half_size, np.float32(np.inf)), half_size)


def _shares(powers: Floats) -> Floats:
    """Powers divided by their sum, which may be 0."""
    shares: Floats = powers / max(powers.max(initial=0.0), 1e-300)  # so that sums are finite
    shares /= max(shares.sum(), 1.0)
    return shares


def light_tree(bounds: Floats, powers: Floats, record: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """The nodes, root first and siblings side by side, and each light's leaf (N,).

    bounds: of the lights, (N, 2, 3) in meters, min before max. powers (N,): from 0 to 1e300. record: the shaders'
    struct LightNode. All nodes of a level are made at once; `solari-vk bench` measures how long that takes.
    """
    count = len(powers)
    nodes = np.zeros(2 * count, record)
    leaves = np.zeros(count, np.uint32)
    shares = _shares(powers)
    centers = bounds.mean(axis=1)
    # The lights of a level, node by node; where each node's lights begin; and the index of each node.
    order = np.arange(count)
    starts = np.zeros(min(count, 1), np.int64)
    level = np.zeros(min(count, 1), np.int64)
    end = 1
    while len(order):
        low = np.minimum.reduceat(bounds[order, 0], starts)
        high = np.maximum.reduceat(bounds[order, 1], starts)
        nodes["center"][level], nodes["half_size"][level] = _box(low, high)
        nodes["power"][level] = np.add.reduceat(shares[order], starts)
        counts = np.diff(starts, append=len(order))
        # A node with a single light is a leaf.
        single = counts == 1
        lights = order[starts[single]]
        nodes["first"][level[single]] = lights
        leaves[lights] = level[single]

        # The others are halved, and the halves are their children, which are the next level.
        order = order[np.repeat(~single, counts)]
        counts = counts[~single]
        parents = level[~single]
        children = np.ones(len(counts), np.int64)  # the number of each node's
        for _ in range(HALVINGS):
            order, counts, halves = _halve(order, counts, centers)
            owners = np.repeat(np.arange(len(children)), children)
            children = np.bincount(owners, halves, len(children)).astype(np.int64)
        level = np.arange(end, end + len(counts))
        end += len(level)
        starts = np.cumsum(counts) - counts
        nodes["first"][parents] = level[np.cumsum(children) - children]
        nodes["child_count"][parents] = children
        nodes["parent"][level] = np.repeat(parents, children)
    # The choice between trees takes the same root of a new tree as of one that followed its lights.
    if count > 1:
        nodes[:1] = _joined(nodes, np.zeros(1, np.int64))
    return nodes[:end], leaves


def _halve(order: Indices, counts: Indices, centers: Floats) -> tuple[Indices, Indices, Indices]:
    """Halves runs of lights, of which `counts` (N,) lie one after the other in `order`, along the axis on which their
    centers spread most. Returns the new order and counts, and for each old run the number of new ones, 1 or 2."""
    if not len(order):
        return order, counts, counts
    starts = np.cumsum(counts) - counts
    reach = np.maximum.reduceat(centers[order], starts) - np.minimum.reduceat(centers[order], starts)
    owner = np.repeat(np.arange(len(counts)), counts)
    order = order[np.lexsort((centers[order, reach.argmax(axis=1)[owner]], owner))]
    halves = np.stack([counts - counts // 2, counts // 2], axis=1)
    return order, halves[halves > 0], np.count_nonzero(halves, axis=1)
