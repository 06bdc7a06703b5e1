"""Axis-aligned boxes: `Bounds`."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
