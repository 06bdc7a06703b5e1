"""Triangles of polygons, which may be concave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.scene.files.libraries import library
from solari_vk.scene.matrices import orthogonal, unit

_BYTES_PER_CORNER = 200


@np.errstate(over="ignore", invalid="ignore")  # of coordinates that are refused later
def triangulate(points: NDArray[Any], counts: NDArray[Any], who: str) -> NDArray[np.int64]:
    """Triangles (M, 3) that cover polygons and no more, by the numbers of corners.

    points (K, 3): the corners of all polygons, one polygon after the other. counts (F,): how many corners each has;
    those with fewer than 3 have no triangle. who: names the file in errors.
    """
    points = np.asarray(points, np.float64)
    first = np.cumsum(counts) - counts
    found = [first[counts == 3, None] + np.arange(3), _halves(points, first[counts == 4])]
    large = counts > 4
    for start, count in zip(first[large].tolist(), counts[large].tolist(), strict=True):
        # Looks at the time that loading takes, too.
        charge(0, who, f"a polygon of {count:,} corners", working=_BYTES_PER_CORNER * count)
        found.append(start + _ears(points[start : start + count], who))
    return np.concatenate(found).astype(np.int64)


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
    # Newell's normal, which is twice the area where a polygon is flat.
    normal = np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0)
    fan = np.stack([np.zeros(len(outline) - 2), *(np.arange(n, len(outline) - 2 + n) for n in (1, 2))], axis=1)
    if not normal.any() or not np.isfinite(normal).all():
        return fan.astype(np.int64)
    along = orthogonal(unit(normal)[None])[0]
    flat = relative @ np.stack([along, np.cross(unit(normal), along)], axis=1)
    ends = np.array([len(outline)], np.uint32)
    found = library("mapbox_earcut", who).triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3)
    if not len(found):  # an outline that crosses itself everywhere
        return fan.astype(np.int64)
    a, b, c = (flat[found[:, corner]] for corner in range(3))
    left, right = b - a, c - a
    turned = left[:, 0] * right[:, 1] < left[:, 1] * right[:, 0]
    found[turned] = found[turned][:, ::-1]
    return np.asarray(found, np.int64)
