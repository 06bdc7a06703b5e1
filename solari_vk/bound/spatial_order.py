"""An order of points in which neighbors in space are neighbors in memory.

Lavapipe (Mesa 25.0) builds its trees over primitives and instances in the given order and halves the list at each
level; with a random order, rays are a hundred times slower than with this order. Other drivers sort primitives
themselves, but gain coherent memory accesses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def spatial_order(points: NDArray[np.floating]) -> Indices:
    """A permutation (N) of points (N, 3): the points are halved along their longest extent, and the halves likewise."""
    axes = np.ascontiguousarray(points.T, np.float32)
    order = np.arange(len(points))
    starts, sizes = np.array([0]), np.array([len(points)])
    while len(points) and sizes.max() > 2:
        for size in np.unique(sizes):  # at most two sizes, because the halves of n differ by at most one
            if size > 2:
                _split(axes, order, starts[sizes == size], int(size))
        starts, sizes = halved(starts, sizes)
    return order


def runs(count: int, largest: int) -> tuple[Indices, Indices, int]:
    """Runs of up to `largest` (2 or more) neighbors among `count` points in their spatial order: where they start (R,)
    and their sizes (R,), and how often the points are halved to make them."""
    starts, sizes, halvings = np.array([0]), np.array([count]), 0
    while sizes.max() > largest:
        starts, sizes = halved(starts, sizes)
        halvings += 1
    return starts, sizes, halvings


def halved(starts: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """The starts and sizes (2 R,) of the halves of runs (R,)."""
    left = sizes // 2
    return np.stack([starts, starts + left], axis=1).ravel(), np.stack([left, sizes - left], axis=1).ravel()


def _split(axes: NDArray[np.float32], order: NDArray[np.int64], starts: NDArray[np.int64], size: int) -> None:
    """Partition each run of `size` points into a lower and an upper half along the run's longest extent."""
    positions = starts[:, None] + np.arange(size)
    runs = axes[:, positions]
    longest = np.argmax([_extent(run) for run in runs], axis=0)
    keys = runs[longest, np.arange(len(starts))]
    chosen = starts[:, None] + np.argpartition(keys, size // 2, axis=1)
    axes[:, positions], order[positions] = axes[:, chosen], order[chosen]


def _extent(runs: NDArray[np.float32]) -> NDArray[np.float32]:
    """The maximum minus the minimum of each row. For many short rows numpy is faster by columns."""
    columns = np.ascontiguousarray(runs.T) if runs.shape[1] < 64 else runs.T
    return np.asarray(columns.max(axis=0) - columns.min(axis=0))
