"""Points and lines as surfaces: small spheres and thin tubes, since glTF gives them no size."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.deform import Vertices
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.matrices import orthogonal, unit

POINT_RADIUS, LINE_RADIUS = 1 / 400, 1 / 1000  # of the diagonal of the primitive's bounds
# A frame has one ray a pixel, at a place that changes, and history is kept only where the next frame finds it again.
_IN_MOTION = (
    "thinner than a pixel they break up in realtime frames in motion: render these larger, or by the path tracer"
)
DRAWN_POINTS = (
    f"points are drawn as spheres with a radius of at most 1/{1 / POINT_RADIUS:.0f} of their primitive's size "
    f"({_IN_MOTION})"
)
DRAWN_LINES = (
    f"lines are drawn as tubes with a radius of 1/{1 / LINE_RADIUS:.0f} of their primitive's size ({_IN_MOTION})"
)
_RADIUS_OF_ONE = 0.01  # in meters, of points that are all at one place
_MOST_POINTS, _MOST_LINES = 2**18, 2**17  # further ones are thinned out
_FEW = 2**15  # that are rounder
_SIDES = 6
# glTF 2.0, 5.24 (Mesh.Primitive): modes.
_LINES = 1
_LINE_LOOP = 2
_BYTES_PER_VERTEX = 256
_BYTES_PER_CORNER = 24  # two ends of a line, and what sorts them


class _Solid(NamedTuple):
    corners: NDArray[np.float64]  # (N, 3), on the unit sphere
    triangles: NDArray[np.int64]  # (T, 3), counter-clockwise from outside


def _solid(corners: Any) -> _Solid:
    """A regular solid of triangles: those of corners with the smallest distance from each other."""
    found = unit(corners)
    distances = np.linalg.norm(found[:, None] - found, axis=-1)
    # Neighbors of a regular solid have the smallest distance of all.
    edge = 1.01 * distances[distances > 0].min()
    faces = [face for face in combinations(range(len(found)), 3) if distances[np.ix_(face, face)].max() < edge]
    return _Solid(found, np.array([face if np.linalg.det(found[list(face)]) > 0 else face[::-1] for face in faces]))


_GOLDEN = (1 + 5**0.5) / 2
_OCTAHEDRON = _solid([np.roll((0, 0, sign), axis) for sign in (1, -1) for axis in range(3)])
_ICOSAHEDRON = _solid([np.roll((0, a, b * _GOLDEN), axis) for a in (1, -1) for b in (1, -1) for axis in range(3)])


def with_surface(
    vertices: Vertices, corners: NDArray[np.uint32], mode: int, primitive: Entry
) -> tuple[Vertices, NDArray[np.uint32], int]:
    """Vertices and triangles of the spheres and tubes of a primitive, and of how many points or lines one is shown.

    All that a vertex has but its normal and tangent is that of the point it belongs to. mode: glTF's, 0 to 3.
    """
    primitive.charge(0, f"{len(corners):,} points or lines", working=_BYTES_PER_CORNER * len(corners))
    lines = _line_ends(corners, mode)
    count, most = (len(lines), _MOST_LINES) if mode else (len(corners), _MOST_POINTS)
    step = max(-(-count // most), 1)
    lines = lines[::step] if mode else lines[:0]
    # The ends of lines are round, so that they join without gaps.
    centers = np.unique(lines) if mode else corners[::step]
    solid = _ICOSAHEDRON if len(centers) <= _FEW else _OCTAHEDRON
    size = len(centers) * len(solid.corners) + 2 * _SIDES * len(lines)
    primitive.charge(0, f"spheres and tubes of {count:,} points or lines", working=_BYTES_PER_VERTEX * size)

    positions = vertices["POSITION"].astype(np.float64)
    # A line without length has no direction, and its ends show it already.
    lines = lines[(positions[lines[:, 0]] != positions[lines[:, 1]]).any(axis=1)]
    ball = np.arange(len(centers))[:, None, None] * len(solid.corners) + solid.triangles
    triangles = [ball.reshape(-1, 3)]
    normals = [np.tile(solid.corners, (len(centers), 1))]
    sources = [np.repeat(centers, len(solid.corners))]
    if len(lines):
        normals.append(_around(unit(positions[lines[:, 1]] - positions[lines[:, 0]])))
        triangles.append(len(sources[0]) + _tubes(len(lines)))
        sources.append(np.repeat(lines, _SIDES))
    source, normal = np.concatenate(sources), np.concatenate(normals)

    radius = _radius(positions[corners], mode, len(centers))
    found = {name: values[source] for name, values in vertices.items() if "TANGENT" not in name.upper()}
    # Spheres and tubes keep the directions of their normals when targets move them.
    found.pop("target_normals", None)
    found["POSITION"] = (positions[source] + radius * normal).astype(np.float32)
    found["NORMAL"] = normal.astype(np.float32)
    return found, np.concatenate(triangles).astype(np.uint32), step


def _line_ends(corners: NDArray[np.uint32], mode: int) -> NDArray[np.uint32]:
    """The vertices (N, 2) of lines: of each two corners, or of a strip, which a loop closes."""
    lines = np.stack([corners[:-1], corners[1:]], axis=1)
    if mode == _LINES:
        return lines[::2]
    if mode == _LINE_LOOP and len(corners) > 1:
        return np.concatenate([lines, corners[[-1, 0]][None]])
    return lines


def _radius(used: NDArray[np.float64], mode: int, count: int) -> float:
    """The radius of spheres and tubes, for `count` points at the places `used`."""
    if not len(used):
        return _RADIUS_OF_ONE
    diagonal = float(np.linalg.norm(np.ptp(used, axis=0)))
    # Points on a surface of the primitive's size would touch each other with 1 / sqrt(count) of it as diameter.
    share = LINE_RADIUS if mode else min(POINT_RADIUS, 0.5 / max(count, 1) ** 0.5)
    return share * diagonal or _RADIUS_OF_ONE


def _around(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """The normals (2 N sides, 3) of tubes along unit vectors (N, 3): a ring at the start and one at the end."""
    # Any ring around the line will do: tubes have no marks.
    across = orthogonal(along)
    turn = 2 * np.pi / _SIDES * np.arange(_SIDES)[:, None]
    ring = np.cos(turn) * across[:, None] + np.sin(turn) * np.cross(along, across)[:, None]
    return np.repeat(ring[:, None], 2, axis=1).reshape(-1, 3)


def _tubes(count: int) -> NDArray[np.int64]:
    """The triangles of so many tubes, each of two rings of vertices."""
    start = np.arange(_SIDES)
    after = np.roll(start, -1)
    tube = np.concatenate(
        [np.stack([start, after, after + _SIDES], axis=1), np.stack([start, after + _SIDES, start + _SIDES], axis=1)]
    )
    tubes: NDArray[np.int64] = np.arange(count)[:, None, None] * 2 * _SIDES + tube
    return tubes.reshape(-1, 3)
