"""A binary tree over the lights that are not at infinity, by which a surface chooses those that light it most.

Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018), without the
splitting; Pharr, Jakob and Humphreys, "Physically Based Rendering" (4th edition, 2023), section 12.6.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.constants import LIGHT_LEAF, NO_INDEX

Floats = NDArray[np.float64]


def light_tree(bounds: Floats, powers: Floats, record: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """The nodes, root first, and each light's leaf (N,).

    bounds: of the lights, (N, 2, 3) in meters, min before max. powers (N,): from 0 to 1e300. record: the shaders'
    struct LightNode. All lights of a level are split at once: 100,000 lights take half a second.
    """
    count = len(powers)
    nodes, leaves = np.zeros(2 * count, record), np.zeros(count, np.uint32)
    shares = powers / max(powers.max(initial=0.0), 1e-300)  # so that sums are finite
    shares /= max(shares.sum(), 1.0)
    centers = bounds.mean(axis=1)
    # The lights of a level's inner nodes, node by node; where each node begins, and its index.
    order, starts, level = np.arange(count), np.zeros(min(count, 1), np.int64), np.zeros(min(count, 1), np.int64)
    end = 2  # node 1 stays empty, so that siblings differ in the lowest bit alone
    nodes["parent"][:1] = NO_INDEX
    while len(order):
        low = np.minimum.reduceat(bounds[order, 0], starts)
        high = np.maximum.reduceat(bounds[order, 1], starts)
        nodes["center"][level] = (low + high) / 2
        nodes["half_size"][level] = (high - low) / 2
        nodes["power"][level] = np.add.reduceat(shares[order], starts)
        counts = np.diff(starts, append=len(order))
        single = counts == 1
        lights = order[starts[single]]
        nodes["first"][level[single]] = lights | LIGHT_LEAF
        leaves[lights] = level[single]

        order = order[np.repeat(~single, counts)]
        counts, parents = counts[~single], level[~single]
        level = np.arange(end, end + 2 * len(counts))
        end += len(level)
        nodes["first"][parents] = level[::2]
        nodes["parent"][level] = np.repeat(parents, 2)
        starts = np.zeros(len(level), np.int64)
        starts[2::2] = np.cumsum(counts)[:-1]
        if len(order):
            reach = np.maximum.reduceat(centers[order], starts[::2]) - np.minimum.reduceat(centers[order], starts[::2])
            owner = np.repeat(np.arange(len(counts)), counts)
            along = centers[order, reach.argmax(axis=1)[owner]]
            order = order[np.lexsort((along, owner))]
            starts[1::2] = starts[::2] + counts // 2
    return nodes, leaves
