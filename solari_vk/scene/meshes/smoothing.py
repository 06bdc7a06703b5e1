"""Normals for meshes that have none, or of zero length."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.tangents import components, neighbors, next_corner, weld

SHARPEST_SMOOTH_ANGLE = math.radians(40)


def smooth_normals(
    positions: NDArray[Any],
    triangles: NDArray[Any],
    sharpest: float = SHARPEST_SMOOTH_ANGLE,
    apart: NDArray[np.int64] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint32]]:
    """Split vertices (K,), their normals (K, 3), and triangles (M, 3) over them.

    Vertex i has the position `positions[split[i]]`. Triangles that share an edge, also by equal positions, have common
    normals at it unless their planes differ by more than `sharpest`, in radians. A normal is the mean over the
    triangles of its vertex, weighted by their angles there: Thürmer and Wüthrich, "Computing vertex normals from
    polygonal facets" (1998). apart (N,): vertices that differ by it stay apart, though they have a common normal.
    """
    welded = weld(positions)[triangles.astype(np.int64)]
    points = np.asarray(positions, np.float64)[triangles]
    face = unit(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]))
    across = neighbors(welded, np.abs(face).max(axis=1) > 0)
    # Each pair of triangles once, from its edge with the lower number.
    edge = np.flatnonzero(across > np.arange(len(across)))
    other = across[edge]
    smooth = (face[edge // 3] * face[other // 3]).sum(axis=1) >= math.cos(sharpest)
    edge, other = edge[smooth], other[smooth]
    # An edge's start is the other's end: both pairs of corners have a common normal.
    group = components(
        len(across), np.concatenate([edge, next_corner(edge)]), np.concatenate([next_corner(other), other])
    )
    # Corners of one group have one normal.
    _, first, corner = np.unique(group, return_index=True, return_inverse=True)
    after, before = (unit(np.roll(points, -step, axis=1) - points) for step in (1, 2))
    # The angle at each corner, between the edges to its neighbors.
    angle = np.arccos(np.clip((after * before).sum(axis=2), -1, 1))
    weighted = (face[:, None, :] * angle[..., None]).reshape(-1, 3)
    summed = np.stack([np.bincount(corner, weighted[:, axis], len(first)) for axis in range(3)], axis=1)
    normals = unit(summed)
    normals[~normals.any(axis=1)] = (0, 1, 0)
    vertices = triangles.reshape(-1).astype(np.int64)
    if apart is not None:
        pairs = np.stack([corner.reshape(-1), apart[vertices]], axis=1)
        _, first, corner = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
        normals = normals[pairs[first, 0]]
    return vertices[first], normals.astype(np.float32), corner.reshape(-1, 3).astype(np.uint32)


def area_vectors(positions: NDArray[Any], triangles: NDArray[Any]) -> NDArray[np.float64]:
    """Normals (M, 3) of triangles (M, 3), whose lengths are twice the areas."""
    a, b, c = (positions[triangles[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def fitted_normals(
    normals: NDArray[Any], triangles: NDArray[Any], areas: NDArray[np.float64]
) -> tuple[NDArray[np.float32], bool]:
    """Unit normals (N, 3), and whether some had no length: these become those of the triangles around.

    areas (M, 3): `area_vectors` of the triangles.
    """
    fitted = unit(normals)
    missing = ~fitted.any(axis=1)
    if missing.any():
        corners = triangles.reshape(-1)
        sums = [np.bincount(corners, np.repeat(areas[:, axis], 3), len(normals)) for axis in range(3)]
        faces = unit(np.stack(sums, axis=1))
        faces[~faces.any(axis=1)] = (0, 1, 0)
        fitted[missing] = faces[missing]
    return fitted.astype(np.float32), bool(missing.any())
