"""A tree over the lights that are not at infinity, by which a surface chooses those that light it most.

What it calls a light may be a cluster of triangles of an emissive mesh. The triangles of a cluster are chosen by the
light that they send out, not by how near they are to the surface.

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018), without the
splitting; Pharr, Jakob and Humphreys, "Physically Based Rendering" (4th edition, 2023), section 12.6.3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
# Times that the lights of a node are halved, so that it has up to 8 children. A choice among several at once is better
# than a row of choices between two, and takes no more time.
HALVINGS = 3
# A tree is built anew when lights have moved so far that the sum of its nodes' sizes has grown by this factor.
MAX_GROWTH = 1.5


class LightChoice(NamedTuple):
    """How light samples choose among a scene's lights: scene/lights/tree.glsl."""

    by_tree: bool = False
    by_strata: bool = False


class LightTree:
    """The tree of a scene's lights. record: the shaders' struct LightNode."""

    def __init__(self, record: np.dtype[Any]) -> None:
        self.nodes: NDArray[Any] = np.zeros(0, record)
        """Root first, siblings side by side."""
        self.leaves: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """Each light's leaf (N,). Each tree that is built anew has a new array."""
        self._ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self._new_size = 0.0  # the sum of the nodes' sizes when the tree was built

    @property
    def has_choice(self) -> bool:
        """Whether there is more than one leaf."""
        return len(self.leaves) > 1

    def update(self, ids: NDArray[np.uint32], bounds: Floats, powers: Floats) -> NDArray[np.uint32]:
        """Follow lights (N,) that move or change their power; returns the indices of all nodes that have changed.

        ids: numbers that stay with the lights; the tree is built anew when they change. bounds, powers: as those of
        `light_tree`.
        """
        if np.array_equal(ids, self._ids):
            leaves = self.nodes[self.leaves]
            _set_bounds(leaves, bounds[:, 0], bounds[:, 1])
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


def _refit(nodes: NDArray[Any], changed: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Compute all nodes above changed ones from their children, and return the indices of both."""
    found = [changed]
    while True:
        # Level by level; the root, node 0, has no parent.
        changed = np.unique(nodes["parent"][changed[changed > 0]])
        if not len(changed):
            return np.unique(np.concatenate(found))
        # Nodes with fewer children than others repeat their first one, which changes no bounds.
        present = np.arange(2**HALVINGS) < nodes["child_count"][changed, None]
        children = nodes[nodes["first"][changed, None] + np.arange(2**HALVINGS) * present]
        low = children["center"] - children["half_size"]
        high = children["center"] + children["half_size"]
        above = nodes[changed]
        _set_bounds(above, low.min(axis=1), high.max(axis=1))
        above["power"] = (children["power"] * present).sum(axis=1)
        nodes[changed] = above
        found.append(changed)


def _set_bounds(nodes: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> None:
    nodes["center"] = (low + high) / 2
    nodes["half_size"] = (high - low) / 2


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
        nodes["center"][level] = (low + high) / 2
        nodes["half_size"][level] = (high - low) / 2
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
