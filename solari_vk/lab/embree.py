"""Embree as a reference for rays, through the package embreex."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def available() -> bool:
    """Whether Embree's Python package is installed and works."""
    try:
        importlib.import_module("embreex.rtcore_scene")
    except ImportError:
        return False
    return True


def embree_scene(corners: NDArray[Any]) -> Any:
    """Embree's scene of triangles (T, 3, 3); its `run(origins, directions)` gives the closest one's index, or -1."""
    # Robust: rays at common edges do not pass between triangles.
    scene = importlib.import_module("embreex.rtcore_scene").EmbreeScene(robust=True)
    vertices = corners.reshape(-1, 3).astype(np.float32)
    indices = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    importlib.import_module("embreex.mesh_construction").TriangleMesh(scene, vertices, indices)
    return scene


def intersect_planes(
    corners: NDArray[Any], index: NDArray[Any], origins: NDArray[Any], directions: NDArray[Any]
) -> tuple[Any, Any]:
    """t at the planes of triangles (N,) in float64, and the distance to the nearest edge; inf for index -1."""
    t = np.full(len(index), np.inf)
    edge = np.full(len(index), np.inf)
    hit = np.flatnonzero(index >= 0)
    hits = corners[index[hit]], origins[hit], directions[hit]
    corners, origins, directions = (values.astype(np.float64) for values in hits)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Rays in the plane of their triangle have no t; the caller counts them as at an edge.
    with np.errstate(divide="ignore", invalid="ignore"):
        t[hit] = _dot(corners[:, 0] - origins, normal) / _dot(directions, normal)
        points = origins + t[hit, None] * directions
    for i in range(3):
        along = corners[:, (i + 1) % 3] - corners[:, i]
        # The nearest point of a side, whose length may be 0.
        part = np.clip(_dot(points - corners[:, i], along) / np.maximum(_dot(along, along), 1e-300), 0, 1)
        apart = np.linalg.norm(points - corners[:, i] - part[:, None] * along, axis=1)
        edge[hit] = np.fmin(edge[hit], apart)
    return t, edge


def _dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return np.einsum("ij,ij->i", a, b)  # type: ignore[no-any-return]
