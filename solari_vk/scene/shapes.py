"""Meshes of simple shapes with normals and texture coordinates. Front faces are outside."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from solari_vk.errors import SolariError
from solari_vk.scene.model import Mesh


def polygons(*corners: ArrayLike, name: str = "") -> Mesh:
    """Flat convex polygons, each (N, 3) with corners counter-clockwise seen from the front, as one mesh.

    The uvs of quads go from (0, 0) at the first corner to (1, 1) at the third; those of other polygons are zero.
    """
    positions, normals, uvs, indices = [], [], [], []
    start = 0
    for given in corners:
        polygon = np.asarray(given, np.float64)
        count = len(polygon)
        normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0])
        positions.append(polygon)
        normals.append(np.tile(normal / np.linalg.norm(normal), (count, 1)))
        uvs.append(np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) if count == 4 else np.zeros((count, 2)))
        indices += [(start, start + i, start + i + 1) for i in range(1, count - 1)]
        start += count
    return Mesh(
        positions=np.concatenate(positions),
        normals=np.concatenate(normals),
        uvs=np.concatenate(uvs),
        triangles=np.array(indices),
        name=name,
    )


def quad(center: ArrayLike, half_u: ArrayLike, half_v: ArrayLike, name: str = "") -> Mesh:
    """A parallelogram around a center, facing cross(half_u, half_v); the half edges are (3,) in meters."""
    c, u, v = (np.asarray(x, np.float64) for x in (center, half_u, half_v))
    return polygons([c - u - v, c + u - v, c + u + v, c - u + v], name=name)


def facing_quad(center: ArrayLike, half_side: float, target: ArrayLike = (0, 0, 0)) -> Mesh:
    """A square with a center (3,) that faces a target (3,), which must not be straight above or below the center."""
    if not 0 < half_side < math.inf:
        raise SolariError(f"a square needs a half side above 0, not {half_side}")
    normal = np.asarray(target, np.float64) - np.asarray(center, np.float64)
    normal /= np.linalg.norm(normal)
    side = np.cross((0.0, 1.0, 0.0), normal)
    side *= half_side / np.linalg.norm(side)
    return quad(center, side, np.cross(normal, side), name="lamp")


def box(low: ArrayLike = (-0.5, -0.5, -0.5), high: ArrayLike = (0.5, 0.5, 0.5), inward: bool = False) -> Mesh:
    """An axis-aligned box of 12 triangles facing outward, or inward as a room does; sides in meters."""
    corner_low, corner_high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if not (corner_low < corner_high).all():
        corners = f"{corner_low.tolist()} and {corner_high.tolist()}"
        raise SolariError(f"a box needs a low corner below the high one, not {corners}")
    center, half = (corner_low + corner_high) / 2, (corner_high - corner_low) / 2
    faces = []
    for axis in range(3):
        u, v = np.zeros(3), np.zeros(3)
        u[(axis + 1) % 3], v[(axis + 2) % 3] = half[(axis + 1) % 3], half[(axis + 2) % 3]
        for sign in (-1.0, 1.0):
            face = center.copy()
            face[axis] += sign * half[axis]
            side = u if (sign > 0) != inward else -u
            faces.append([face - side - v, face + side - v, face + side + v, face - side + v])
    return polygons(*faces, name="box")


def sphere(radius: float = 1.0, segments: int = 32) -> Mesh:
    """A sphere around the origin with smooth normals. segments: at least 3, around; half as many from pole to pole."""
    if not 0 < radius < math.inf:
        raise SolariError(f"a sphere needs a radius above 0, not {radius}")
    if segments < 3:
        raise SolariError(f"a sphere needs at least 3 segments, not {segments}")
    rings = max(segments // 2, 2)
    row, column = (grid.ravel() for grid in np.mgrid[0 : rings + 1, 0 : segments + 1])
    polar, turn = row * (math.pi / rings), column * (2 * math.pi / segments)
    # The last column repeats the positions of the first with u = 1; the positions are equal, so there is no gap.
    turn = np.where(column == segments, 0.0, turn)
    sine = np.where((row == 0) | (row == rings), 0.0, np.sin(polar))
    directions = np.stack([sine * np.sin(turn), np.cos(polar), sine * np.cos(turn)], axis=1)
    indices = []
    for ring, segment in product(range(rings), range(segments)):
        first = ring * (segments + 1) + segment
        below = first + segments + 1
        if ring < rings - 1:
            indices.append((first, below, below + 1))
        if ring > 0:
            indices.append((first, below + 1, first + 1))
    return Mesh(
        positions=(radius * directions).astype(np.float32),
        normals=directions,
        uvs=np.stack([column / segments, row / rings], axis=1),
        triangles=np.array(indices),
        name="sphere",
    )
