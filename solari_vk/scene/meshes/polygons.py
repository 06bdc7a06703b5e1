"""Triangles of polygons, which may be concave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.scene.files.libraries import library
from solari_vk.scene.matrices import orthogonal, unit

_BYTES_PER_CORNER = 200
_ROUNDING = 1e-6  # of a polygon's area, where corners on a line are rounded


@np.errstate(over="ignore", invalid="ignore")  # of coordinates that are refused later
def triangulate(points: NDArray[Any], counts: NDArray[Any], who: str) -> NDArray[np.int64]:
    """Triangles (M, 3) that cover polygons and no more, by the numbers of corners.

    Outlines that cross themselves have no inside that all programs agree on: theirs aren't exact.

    points (K, 3): the corners of all polygons, one polygon after the other. counts (F,): how many corners each has;
    those with fewer than 3 have no triangle. who: names the file in errors.
    """
    points = np.asarray(points, np.float64)
    first = np.cumsum(counts) - counts
    found = [first[counts == 3, None] + np.arange(3), _halves(points, first[counts == 4])]
    large = counts > 4
    fans, is_covered = _fans(points, first[large], counts[large])
    found.append(fans)
    concave = np.flatnonzero(large)[~is_covered]
    for start, count in zip(first[concave].tolist(), counts[concave].tolist(), strict=True):
        # Looks at the time that loading takes, too.
        charge(0, who, f"a polygon of {count:,} corners", working=_BYTES_PER_CORNER * count)
        found.append(start + _ears(points[start : start + count], who))
    return np.concatenate(found).astype(np.int64)


def _fans(
    points: NDArray[np.float64], first: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Triangles (M, 3) around the first corners of polygons of more than three, and which of those (F,) they cover and
    no more: convex ones, and all that are seen whole from there. The others have none."""
    each = counts - 2
    polygon = np.repeat(np.arange(len(counts)), each)
    starts = np.cumsum(each) - each
    seconds = (first + 1 - starts)[polygon, None] + np.arange(len(polygon))[:, None]
    triangles = np.asarray(seconds + np.array([0, 0, 1]), np.int64)
    triangles[:, 0] = first[polygon]
    if not len(triangles):
        return triangles, np.zeros(0, bool)
    a, b, c = points[triangles].swapaxes(0, 1)
    crossed = np.cross(b - a, c - a)
    # Newell's normal, which is twice the area where a polygon is flat: a triangle of a fan faces as it does.
    normals = np.add.reduceat(crossed, starts)
    facing = np.minimum.reduceat((crossed * normals[polygon]).sum(axis=1), starts)
    # Places that are no numbers are refused later.
    is_covered = ~(facing < -_ROUNDING * (normals * normals).sum(axis=1))
    return triangles[is_covered[polygon]], is_covered


def _halves(points: NDArray[np.float64], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Two triangles (2 F, 3) of each polygon of four corners, which begin with these."""
    a, b, c, d = (points[first + number] for number in range(4))
    # The diagonal from a to c leaves the outline where b or d is a concave corner: the halves then face apart.
    apart = (np.cross(b - a, c - a) * np.cross(c - a, d - a)).sum(axis=-1) < 0
    split = np.where(apart[:, None], [0, 1, 3, 1, 2, 3], [0, 1, 2, 0, 2, 3])
    return (first[:, None] + split).reshape(-1, 3)


def _ears(outline: NDArray[np.float64], who: str) -> NDArray[np.int64]:
    """Triangles (M, 3) of one polygon, by cutting ears: Held, "FIST: Fast Industrial-Strength Triangulation of
    Polygons" (2001)."""
    relative = outline - outline[0]
    normal = np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0)
    fan = np.stack([np.zeros(len(outline) - 2), *(np.arange(n, len(outline) - 2 + n) for n in (1, 2))], axis=1)
    along = orthogonal(unit(normal)[None])[0]
    flat = relative @ np.stack([along, np.cross(unit(normal), along)], axis=1)
    if not np.isfinite(flat).all():
        return fan.astype(np.int64)
    ends = np.array([len(outline)], np.uint32)
    found = library("mapbox_earcut", who).triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3)
    if not len(found):  # an outline that crosses itself everywhere
        return fan.astype(np.int64)
    a, b, c = (flat[found[:, corner]] for corner in range(3))
    left, right = b - a, c - a
    turned = left[:, 0] * right[:, 1] < left[:, 1] * right[:, 0]
    found[turned] = found[turned][:, ::-1]
    return np.asarray(found, np.int64)
