"""Axis-aligned boxes: `Bounds`."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.matrices import transform_points


class Bounds(NamedTuple):
    """An axis-aligned box: its corners `min` and `max`, (3,) each, in meters."""

    min: NDArray[np.float64]
    max: NDArray[np.float64]

    @property
    def center(self) -> NDArray[np.float64]:
        """The center, (3,) in meters."""
        return (self.min + self.max) / 2

    @property
    def size(self) -> NDArray[np.float64]:
        """The lengths of the sides, (3,) in meters."""
        return self.max - self.min

    @property
    def radius(self) -> float:
        """The radius of the sphere around the box: half its diagonal, in meters."""
        return float(np.linalg.norm(self.size)) / 2

    @property
    def corners(self) -> NDArray[np.float64]:
        """The eight corners, (8, 3) in meters."""
        return np.array(list(product(*zip(self.min, self.max, strict=True))))


def bounds_of(instances: Iterable[Any]) -> Bounds | None:
    """The bounding box of instances in their poses, None without any."""
    corners = []
    boxes: dict[Any, NDArray[Any]] = {}
    for instance in instances:
        mesh = instance.posed_mesh()
        if mesh not in boxes:
            boxes[mesh] = Bounds(mesh.positions.min(axis=0), mesh.positions.max(axis=0)).corners
        corners.append(transform_points(instance.transform, boxes[mesh]))
    if not corners:
        return None
    every = np.concatenate(corners)
    return Bounds(every.min(axis=0), every.max(axis=0))
