"""Puts things in an order in which neighbours in space are neighbours in memory.

Lavapipe (Mesa 25.0) builds its trees over primitives and instances in the order given, halving the list at
every level: a random order traces a hundred times slower than this one. Other drivers sort by themselves,
and gain coherent memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def spatial_order(points: NDArray[np.floating]) -> NDArray[np.int64]:
    """A permutation of points (N, 3): every half of it, and half of a half, is split along its longest extent."""
    axes = np.ascontiguousarray(points.T, np.float32)
    order = np.arange(len(points))
    starts, sizes = np.array([0]), np.array([len(points)])
    while len(points) and sizes.max() > 2:
        for size in np.unique(sizes):  # two sizes at most: halves of n differ by one
            if size > 2:
                _split(axes, order, starts[sizes == size], int(size))
        left = sizes // 2
        starts = np.stack([starts, starts + left], axis=1).ravel()
        sizes = np.stack([left, sizes - left], axis=1).ravel()
    return order


def _split(axes: NDArray[np.float32], order: NDArray[np.int64], starts: NDArray[np.int64], size: int) -> None:
    """Reorder each run of `size` so that its first half comes before its second along the run's longest extent."""
    places = starts[:, None] + np.arange(size)
    runs = axes[:, places]
    longest = np.argmax([_extent(run) for run in runs], axis=0)
    keys = runs[longest, np.arange(len(starts))]
    chosen = starts[:, None] + np.argpartition(keys, size // 2, axis=1)
    axes[:, places], order[places] = axes[:, chosen], order[chosen]


def _extent(runs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Greatest less least of each row; many short rows are quicker taken by columns."""
    columns = np.ascontiguousarray(runs.T) if runs.shape[1] < 64 else runs.T
    return np.asarray(columns.max(axis=0) - columns.min(axis=0))
