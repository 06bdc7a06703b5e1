"""Pictures at places between pixels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Whole = NDArray[np.intp]
_SWING = np.float32(1.25)
_REACH = 6  # pixels: beyond it the filter's weights are below 0.001


def pixel_grid(height: int, width: int) -> Floats:
    """The place (x, y) of each pixel's center, (height, width, 2): 0 is the center of the first one."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def nearest(picture: Floats, places: Floats) -> Floats:
    """The pixels nearest to places (height, width, 2); beyond an edge those at the edge."""
    height, width = picture.shape[:2]
    rows = np.clip(np.rint(places[..., 1]), 0, height - 1).astype(np.intp)
    columns = np.clip(np.rint(places[..., 0]), 0, width - 1).astype(np.intp)
    return picture[rows, columns]


def bilinear_taps(places: Floats, height: int, width: int) -> Iterator[tuple[Whole, Whole, Floats]]:
    """Of each of the four pixels around places: rows, columns, and bilinear weights."""
    left = np.floor(places)
    share = places - left
    for down in (0, 1):
        for right in (0, 1):
            rows = np.clip(left[..., 1] + down, 0, height - 1).astype(np.intp)
            columns = np.clip(left[..., 0] + right, 0, width - 1).astype(np.intp)
            across = share[..., 0] if right else 1 - share[..., 0]
            along = share[..., 1] if down else 1 - share[..., 1]
            yield rows, columns, across * along


def bilinear(picture: Floats, places: Floats) -> Floats:
    """The picture (height, width, n) at places."""
    total = np.zeros((*places.shape[:2], picture.shape[2]), np.float32)
    for rows, columns, weight in bilinear_taps(places, *picture.shape[:2]):
        total += weight[..., None] * picture[rows, columns]
    return total


def spline_coefficients(picture: Floats) -> Floats:
    """The coefficients for `spline` of a picture (height, width, n): cubic B-splines that go through its pixels.

    The recursive filter of Unser, "Splines: A Perfect Fit for Signal and Image Processing" (1999), as the finite filter
    that it nearly is.
    """
    pole = np.sqrt(3) - 2
    weights = -6 * pole / (1 - pole**2) * pole ** np.abs(np.arange(-_REACH, _REACH + 1))
    weights /= weights.sum()
    for axis in (0, 1):
        margin = [(0, 0)] * 3
        margin[axis] = (_REACH, _REACH)
        padded = np.pad(picture, margin, mode="edge")
        count = picture.shape[axis]
        shifted = [np.take(padded, range(start, start + count), axis) for start in range(len(weights))]
        picture = np.asarray(sum(w * part for w, part in zip(weights, shifted, strict=True)), np.float32)
    return picture


def spline(coefficients: Floats, places: Floats) -> Floats:
    """The picture (height, width, n) of `spline_coefficients` at places. It blurs less than bilinear weights and
    Catmull-Rom splines."""
    height, width = coefficients.shape[:2]
    first = np.floor(places)
    across, down = (_spline_weights(places[..., axis] - first[..., axis]) for axis in (0, 1))
    rows = [np.clip(first[..., 1] + step, 0, height - 1).astype(np.intp) for step in (-1, 0, 1, 2)]
    columns = [np.clip(first[..., 0] + step, 0, width - 1).astype(np.intp) for step in (-1, 0, 1, 2)]
    total = np.zeros((*places.shape[:2], coefficients.shape[2]), np.float32)
    for row, row_weight in zip(rows, down, strict=True):
        for column, column_weight in zip(columns, across, strict=True):
            total += (row_weight * column_weight)[..., None] * coefficients[row, column]
    return total


def limited(values: Floats, picture: Floats, places: Floats) -> Floats:
    """Values at places, near the range of the four pixels of a picture around each: splines swing about lamps, and
    would leave black pixels beside them."""
    taps = [picture[rows, columns] for rows, columns, _ in bilinear_taps(places, *picture.shape[:2])]
    found: Floats = np.clip(values, np.min(taps, axis=0) / _SWING, np.max(taps, axis=0) * _SWING)
    return found


def _spline_weights(share: Floats) -> tuple[Any, ...]:
    rest = 1 - share
    return (rest**3 / 6, (3 * share**3 - 6 * share**2 + 4) / 6, (3 * rest**3 - 6 * rest**2 + 4) / 6, share**3 / 6)


def box_mean(values: Floats, radius: int) -> Floats:
    """The mean of values (height, width) over squares of 2 * radius + 1 pixels, those at the edge repeated."""
    size = 2 * radius + 1
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (radius + 1, radius)
        sums = np.cumsum(np.pad(values, margin, mode="edge"), axis=axis, dtype=np.float64)
        ends = np.take(sums, range(size, sums.shape[axis]), axis)
        starts = np.take(sums, range(0, sums.shape[axis] - size), axis)
        values = np.asarray((ends - starts) / size, np.float32)
    return values
