"""An order of boxes in which neighbors in space are neighbors in memory.

Lavapipe (Mesa 25.0) builds its trees over primitives and instances in the given order and halves the list at each
level, the larger half first. With a random order, rays are a hundred times slower than with this one, which chooses
each halving by the surface area heuristic (MacDonald and Booth, "Heuristics for ray tracing using space subdivision",
1990). Other drivers, and the trees of solari_vk/gpu/trees, sort primitives themselves and only gain coherent memory
accesses, for which a Z-order curve does as well in a twentieth of the time.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]
# Numpy reduces rows of fewer numbers faster column by column.
SHORT = 16
# Of each coordinate of a Z-order curve. Three of them fill 63 bits.
CURVE_BITS = 21
# Of a list's longest extent: by how much boxes are thicker where areas are compared, so that no area is 0.
THIN = 1e-3


def spatial_order(low: NDArray[np.floating], high: NDArray[np.floating] | None = None) -> Indices:
    """A permutation (N) of boxes from `low` to `high`, both (N, 3), or of points (N, 3).

    The boxes are sorted by their centers along an axis and halved, and the halves likewise. The axis is that whose
    halves have the least surface area.
    """
    boxes = np.concatenate([low.T, (low if high is None else high).T], dtype=np.float32)
    order = np.arange(len(low))
    starts, sizes = np.array([0]), np.array([len(low)])
    while len(low) and sizes.max() > 2:
        for size in np.unique(sizes):  # at most two sizes, because the halves of n differ by at most one
            if size > 2:
                _split(boxes, order, starts[sizes == size], int(size))
        starts, sizes = halved(starts, sizes)
    return order


def memory_order(kind: str, low: NDArray[np.floating], high: NDArray[np.floating]) -> Indices:
    """The permutation (N) in which a device of a kind such as "cpu" gets boxes from `low` to `high`, both (N, 3)."""
    return spatial_order(low, high) if kind == "cpu" else z_order(low, high)


def z_order(low: NDArray[np.floating], high: NDArray[np.floating]) -> Indices:
    """A permutation (N) that sorts boxes from `low` to `high`, both (N, 3), by where on a Z-order curve their centers
    are: Morton, "A computer oriented geodetic data base and a new technique in file sequencing" (1966)."""
    if len(low) == 0:
        return np.arange(0)
    with np.errstate(invalid="ignore"):
        centers = low.astype(np.float64) + high
    centers = np.nan_to_num(centers, posinf=0.0, neginf=0.0)  # boxes that aren't finite may be anywhere
    centers -= centers.min(axis=0)
    cells = centers / (centers.max() or 1.0) * ((1 << CURVE_BITS) - 1)
    x, y, z = (_two_zeros_after_each_bit(column) for column in cells.T.astype(np.uint64))
    return np.argsort(x | y << np.uint64(1) | z << np.uint64(2), kind="stable")


def _two_zeros_after_each_bit(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        numbers = (numbers | numbers << np.uint64(shift)) & np.uint64(mask)
    return numbers


def runs(count: int, largest: int) -> tuple[Indices, Indices, int]:
    """Runs of up to `largest` (2 or more) neighbors among `count` points in their spatial order: where they start (R,)
    and their sizes (R,), and how often the points are halved to make them."""
    starts = np.array([0])
    sizes = np.array([count])
    halvings = 0
    while sizes.max() > largest:
        starts, sizes = halved(starts, sizes)
        halvings += 1
    return starts, sizes, halvings


def halved(starts: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """The starts and sizes (2 R,) of the halves of runs (R,), the larger half first."""
    right = sizes // 2
    left = sizes - right
    return np.stack([starts, starts + left], axis=1).ravel(), np.stack([left, right], axis=1).ravel()


def _split(boxes: NDArray[np.float32], order: Indices, starts: Indices, size: int) -> None:
    """Sort each run of `size` boxes (6, N) into a lower and an upper half along the run's best axis."""
    positions = starts[:, None] + np.arange(size)
    found = boxes.take(positions, axis=1)  # several times as fast as by index arrays
    rows = size * np.arange(len(starts))[:, None]
    left = size - size // 2
    flat = found.reshape(6, -1)
    longest = _extents(found).max(axis=0)
    longest[longest == 0] = 1
    # Each axis is tried, and each run takes the axis whose halves cost least: their areas times their numbers of boxes.
    best = least = None
    for low, high in zip(found[:3], found[3:], strict=True):
        chosen = np.argpartition(low + high, left - 1, axis=1)
        parts = flat.take(rows + chosen, axis=1)
        cost = left * _area(parts[:, :, :left], longest) + (size - left) * _area(parts[:, :, left:], longest)
        if best is None or least is None:
            best, least = chosen, cost
        better = cost < least
        best[better] = chosen[better]
        least[better] = cost[better]
    assert best is not None
    boxes[:, positions] = flat.take(rows + best, axis=1)
    order[positions] = order.take(starts[:, None] + best)


def _extents(runs: NDArray[np.float32]) -> NDArray[np.float32]:
    """The extents (3, R) of the bounds of runs of boxes (6, R, K)."""
    extents: NDArray[np.float32]
    if runs.shape[2] < SHORT:
        columns = np.moveaxis(runs, 2, 0)
        extents = reduce(np.maximum, columns[:, 3:]) - reduce(np.minimum, columns[:, :3])
    else:
        extents = runs[3:].max(axis=2) - runs[:3].min(axis=2)
    return extents


def _area(runs: NDArray[np.float32], unit: NDArray[np.float32]) -> NDArray[np.float32]:
    """Half the surface area (R,) of the bounds of runs of boxes (6, R, K), in squares of a unit of length (R,)."""
    x, y, z = _extents(runs) / unit + np.float32(THIN)
    area: NDArray[np.float32] = x * y + y * z + z * x
    return area
