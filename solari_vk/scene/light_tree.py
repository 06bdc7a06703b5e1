"""A tree over the lights that are not at infinity, by which a surface chooses those that light it most.

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018), without the
splitting; Pharr, Jakob and Humphreys, "Physically Based Rendering" (4th edition, 2023), section 12.6.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
HALVINGS = 3
"""Times that the lights of a node are halved, so that it has up to 8 children. A choice among several at once is better
than a row of choices between two, and takes no more time."""


def light_tree(bounds: Floats, powers: Floats, record: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """The nodes, root first and siblings side by side, and each light's leaf (N,).

    bounds: of the lights, (N, 2, 3) in meters, min before max. powers (N,): from 0 to 1e300. record: the shaders'
    struct LightNode. All nodes of a level are made at once; `solari-vk bench` measures how long that takes.
    """
    count = len(powers)
    nodes, leaves = np.zeros(2 * count, record), np.zeros(count, np.uint32)
    shares = powers / max(powers.max(initial=0.0), 1e-300)  # so that sums are finite
    shares /= max(shares.sum(), 1.0)
    centers = bounds.mean(axis=1)
    # The lights of a level, node by node; where each node begins; and its index.
    order, starts, level = np.arange(count), np.zeros(min(count, 1), np.int64), np.zeros(min(count, 1), np.int64)
    end = 1
    while len(order):
        low, high = np.minimum.reduceat(bounds[order, 0], starts), np.maximum.reduceat(bounds[order, 1], starts)
        nodes["center"][level], nodes["half_size"][level] = (low + high) / 2, (high - low) / 2
        nodes["power"][level] = np.add.reduceat(shares[order], starts)
        counts = np.diff(starts, append=len(order))
        single = counts == 1
        lights = order[starts[single]]
        nodes["first"][level[single]] = lights
        leaves[lights] = level[single]

        order, counts, parents = order[np.repeat(~single, counts)], counts[~single], level[~single]
        children = np.ones(len(counts), np.int64)
        for _ in range(HALVINGS):
            order, counts, halves = _halve(order, counts, centers)
            owners = np.repeat(np.arange(len(children)), children)
            children = np.bincount(owners, halves, len(children)).astype(np.int64)
        level = np.arange(end, end + len(counts))
        end += len(level)
        starts = np.cumsum(counts) - counts
        nodes["first"][parents], nodes["child_count"][parents] = level[np.cumsum(children) - children], children
        nodes["parent"][level] = np.repeat(parents, children)
    return nodes, leaves


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
