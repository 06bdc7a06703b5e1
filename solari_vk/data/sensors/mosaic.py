"""Color filter arrays: Bayer, US patent 3,971,065 (1976)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")


def bayer_colors(pattern: str, shape: tuple[int, int]) -> NDArray[np.int64]:
    """The color of each pixel, (height, width): 0, 1, 2 for red, green, blue."""
    block = np.array(["RGB".index(letter) for letter in pattern]).reshape(2, 2)
    return np.tile(block, (-(-shape[0] // 2), -(-shape[1] // 2)))[: shape[0], : shape[1]]


def demosaic(values: Floats, colors: NDArray[np.int64]) -> Floats:
    """All three colors (height, width, 3) of pixels that have one each, by bilinear interpolation."""
    found = np.empty((*values.shape, 3))
    for color in range(3):
        own = colors == color
        found[..., color] = np.where(own, values, _spread(np.where(own, values, 0.0)) / _spread(own.astype(np.float64)))
    return found


def _spread(values: Floats) -> Floats:
    """Each value plus half of its neighbors and a quarter of those across corners."""
    rows = np.pad(values, ((1, 1), (0, 0)))
    rows = rows[1:-1] + (rows[:-2] + rows[2:]) / 2
    columns = np.pad(rows, ((0, 0), (1, 1)))
    found: Floats = columns[:, 1:-1] + (columns[:, :-2] + columns[:, 2:]) / 2
    return found
