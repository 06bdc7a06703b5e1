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


# From where on points are far from 0: beyond this, in meters, and beyond this multiple of their extent.
FAR = 4096.0
FAR_FOR_ITS_SIZE = 64.0
_STEP = 16.0  # meters


def origin_near(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where to count the coordinates of points (N, 3) from, (3,) in meters, so that numbers of 32 bits are precise: 0,
    or a place among them if they are far from 0."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    middle = (low + high) / 2
    distance = float(np.abs(middle).max())
    is_far = distance > FAR and distance > FAR_FOR_ITS_SIZE * float((high - low).max())
    # A number that has no error with 32 bits.
    return (np.rint(middle / _STEP) * _STEP).astype(np.float32).astype(np.float64) if is_far else np.zeros(3)


def origin_of(instances: Iterable[Any]) -> NDArray[np.float64]:
    """As `origin_near`, of instances. Meshes that only the device knows count as points."""
    every = list(instances)
    if not every:
        return np.zeros(3)
    middles = {mesh: _middle(mesh) for mesh in dict.fromkeys(instance.mesh for instance in every)}
    transforms = np.array([instance.transform for instance in every])
    places = np.einsum("nij,nj->ni", transforms[:, :3], [middles[instance.mesh] for instance in every])
    return origin_near(places)


def _middle(mesh: Any) -> NDArray[np.float64]:
    """The center of a mesh, (4,): x, y, z, 1; 0, 0, 0, 1 if only the device knows it."""
    positions = mesh._stored("positions")
    if not isinstance(positions, np.ndarray) or not len(positions):
        return np.array([0.0, 0.0, 0.0, 1.0])
    ends = np.stack([positions.min(axis=0), positions.max(axis=0)]).astype(np.float64)
    return np.append(ends.mean(axis=0), 1.0)


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
