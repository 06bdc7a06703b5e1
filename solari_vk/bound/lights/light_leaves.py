"""What light samples choose first: leaves, each of them a light or a cluster of triangles of an emissive mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import FEW_LEAVES, NO_INDEX
from solari_vk.bound.lights.alias_table import alias_table
from solari_vk.bound.lights.clusters import Clusters
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.bound.lights.light_tree import LightChoice, LightTree
from solari_vk.bound.table import MakeTable

Floats = NDArray[np.float64]
# The share of light samples that takes all lit lights with equal probability, for weak lights that are near and for
# strong ones behind walls, such as the sun: no light is taken less than half as often as by either rule alone.
EQUAL_SHARE = 0.5
# The share of the light samples of environments that goes through portals: in rooms all should, elsewhere none, and
# which receivers are in rooms isn't known. Samples of all other lights are as many as without portals.
PORTAL_SHARE = 0.5


class LightLeaves:
    """The tables `light_leaves`, in the order of the lights, and `light_tree` over those that are not at infinity."""

    def __init__(self, table: MakeTable, block_dtypes: dict[str, Any]) -> None:
        self.table = table("light_leaves", block_dtypes["light_leaves"])
        self.tree = table("light_tree", block_dtypes["light_tree"])
        self.firsts: NDArray[np.int64] = np.zeros(0, np.int64)
        """Each light's first leaf (N,)."""
        self.count = 0
        self.node_count = 0
        self.light_tree = LightTree(block_dtypes["light_tree"])
        self.choice = LightChoice()
        self._lights: NDArray[np.int64] = np.zeros(0, np.int64)  # of each leaf
        self._shares: Floats = np.zeros(0)  # of each leaf in its light
        self._bounds: Floats = np.zeros((0, 2, 3))
        self._whole: NDArray[np.int64] = np.zeros(0, np.int64)  # the leaves that are a light

    def arrange(self, clusters: Sequence[Clusters | None], part_counts: NDArray[np.uint32]) -> None:
        """Make the leaves of other lights: clusters (N,), None for a light that is a leaf; part_counts (N,)."""
        counts = np.fromiter((1 if found is None else len(found.starts) for found in clusters), np.int64, len(clusters))
        self.count = int(counts.sum())
        self.firsts = np.cumsum(counts) - counts
        self._lights = np.repeat(np.arange(len(counts)), counts)
        self._shares = np.ones(self.count)
        self._bounds = np.zeros((self.count, 2, 3))
        self._whole = self.firsts[counts == 1]
        self.table.reserve(self.count)
        records = self.table.records[: self.count]
        records["light"] = self._lights
        records["first_part"] = 0
        records["part_count"] = part_counts[self._lights]
        for light in np.flatnonzero(counts > 1).tolist():
            of_light = clusters[light]
            assert of_light is not None
            leaves = self.leaves(light)
            records["first_part"][leaves] = of_light.starts
            records["part_count"][leaves] = of_light.sizes
            self._shares[leaves] = of_light.shares

    def leaves(self, light: int) -> slice:
        """The leaves of a light."""
        first = int(self.firsts[light])
        return slice(first, int(self.firsts[light + 1]) if light + 1 < len(self.firsts) else self.count)

    def choose(self, weights: Floats) -> None:
        """Write how often leaves are chosen by power. weights (N,): how often lights are."""
        records = self.table.records[: self.count]
        # A cluster gets its share of how often its light is chosen.
        records["by_power"] = alias_table(weights[self._lights] * self._shares, records["by_power"].dtype)
        self.table.mark(range(self.count))

    def follow(
        self, ids: NDArray[np.uint32], bounds: Floats, powers: Floats, boxes: dict[int, Floats], has_portals: bool
    ) -> float:
        """Have the tree follow the lights (F,) that are not at infinity; returns how often it chooses.

        ids, bounds, powers: as those of `LightTree`. boxes: those of the clusters of lights that have moved.
        """
        # The leaves of lights at infinity are the last ones, and not in the tree.
        count = int(self.firsts[len(ids)]) if len(ids) < len(self.firsts) else self.count
        lights = self._lights[:count]
        whole = self._whole[: np.searchsorted(self._whole, count)]
        self._bounds[whole] = bounds[self._lights[whole]]
        for light, of_clusters in boxes.items():
            self._bounds[self.leaves(light)] = of_clusters
        before = self.light_tree.leaves
        changed = self.light_tree.update(ids[lights], self._bounds[:count], powers[lights] * self._shares[:count])
        self.node_count = len(self.light_tree.nodes)
        self.tree.reserve(self.node_count)
        self.tree.records[changed] = self.light_tree.nodes[changed]
        self.tree.mark(changed.tolist())
        in_tree = count if self.light_tree.has_choice else 0
        records = self.table.records[: self.count]
        records["node"] = NO_INDEX
        records["node"][:in_tree] = self.light_tree.leaves[:in_tree]
        # A refitted tree has the same leaves, and of its nodes only those that changed are uploaded.
        if self.light_tree.leaves is not before:
            self.table.mark(range(self.count))
        is_few = self.count <= FEW_LEAVES and not has_portals
        by_strata = self.count > 1 and (is_few or 0 < in_tree < self.count)
        self.choice = LightChoice(in_tree > 0, by_strata)
        if 0 < in_tree == self.count:
            return 1.0
        chosen = float(records["by_power"]["probability"][:in_tree].sum(dtype=np.float64))
        # At most the float32 below 1, so that the lights at infinity are chosen too.
        return min(chosen, 1.0 - 2.0**-24)


def choice_weights(powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """How often light samples take lights of these powers (N,), up to a factor; dark lights are never taken."""
    lit = powers > 0
    highest = powers.max(initial=0.0)
    if not highest > 0:
        return powers
    shares = powers / highest
    weights: NDArray[np.float64] = (1 - EQUAL_SHARE) * shares / shares.sum() + EQUAL_SHARE * lit / np.count_nonzero(lit)
    return weights


def choice_weights_by_kind(powers: NDArray[np.float64], kinds: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The same for lights of these kinds (N,), of which portals take their share from environments, by their power."""
    portal, environment = (kinds == KIND_INDEX[name] for name in ("portal", "environment"))
    weights = choice_weights(np.where(portal, 0.0, powers))
    through = powers[portal].sum()
    if through > 0:
        weights[portal] = PORTAL_SHARE * weights[environment].sum() * powers[portal] / through
        weights[environment] *= 1 - PORTAL_SHARE
    return weights
