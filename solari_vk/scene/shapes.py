"""Meshes of simple shapes with normals and texture coordinates. Front faces are outside."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_attribute
from solari_vk.scene.model import Mesh

__all__ = ["box", "capsule", "cone", "cylinder", "facing_quad", "plane", "polygons", "quad", "sphere", "torus"]


def polygons(*corners: ArrayLike, name: str = "") -> Mesh:
    """Flat convex polygons, each (N, 3) with corners counter-clockwise seen from the front, as one mesh.

    The uvs of quads go from (0, 0) at the first corner to (1, 1) at the third; those of other polygons are zero.
    """
    positions: list[NDArray[np.float64]] = []
    normals: list[NDArray[np.float64]] = []
    uvs: list[NDArray[Any]] = []
    indices: list[tuple[int, int, int]] = []
    start = 0
    for polygon_corners in corners:
        polygon = np.asarray(polygon_corners, np.float64)
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
    """A square with a center (3,) that faces a target (3,); its sides are level. Raises SolariError for a target at the
    center."""
    if not 0 < half_side < math.inf:
        raise SolariError(f"a square needs a half side above 0, not {half_side}")
    normal = np.asarray(target, np.float64) - np.asarray(center, np.float64)
    distance = np.linalg.norm(normal)
    if not 0 < distance < math.inf:
        raise SolariError(f"a square faces a target elsewhere than its center, not {quoted(target)}")
    normal /= distance
    side = np.cross((0.0, 1.0, 0.0), normal)
    length = np.linalg.norm(side)
    # Above or below the target any horizontal side is level.
    side = half_side * (side / length if length > 1e-6 else np.array((1.0, 0.0, 0.0)))
    return quad(center, side, np.cross(normal, side), name="lamp")


@checked_keywords(who="shapes")
def box(low: ArrayLike | None = None, high: ArrayLike | None = None, inward: bool = False) -> Mesh:
    """An axis-aligned box of 12 triangles facing outward, or inward as a room does, between its lowest and its highest
    corner, (3,) each in meters; without them a cube of 1 m about the origin. Raises SolariError for other arguments."""
    if low is None and high is None:
        low, high = (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)
    try:
        corner_low, corner_high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        right = corner_low.shape == corner_high.shape == (3,) and bool((corner_low < corner_high).all())
    except (TypeError, ValueError):
        right = False
    if not right:
        raise SolariError(
            f"shapes.box: takes its lowest and its highest corner, three numbers each, not {quoted(low)} "
            f"and {quoted(high)}; a cube of 2 m is box((-1, -1, -1), (1, 1, 1))"
        )
    center = (corner_low + corner_high) / 2
    half = (corner_high - corner_low) / 2
    faces = []
    for axis in range(3):
        u, v = np.zeros(3), np.zeros(3)
        # Cyclic order, so that cross(u, v) points along the axis.
        u[(axis + 1) % 3] = half[(axis + 1) % 3]
        v[(axis + 2) % 3] = half[(axis + 2) % 3]
        for sign in (-1.0, 1.0):
            face = center.copy()
            face[axis] += sign * half[axis]
            # Corners run counter-clockwise seen from outside, or from inside if it faces inward.
            side = u if (sign > 0) != inward else -u
            faces.append([face - side - v, face + side - v, face + side + v, face - side + v])
    return polygons(*faces, name="box")


@checked_keywords(who="shapes")
def sphere(radius: float = 1.0, segments: int = 32) -> Mesh:
    """A sphere around the origin with smooth normals. segments: at least 3, around; half as many from pole to pole."""
    if not 0 < radius < math.inf:
        raise SolariError(f"a sphere needs a radius above 0, not {radius}")
    if segments < 3:
        raise SolariError(f"a sphere needs at least 3 segments, not {segments}")
    rings = max(segments // 2, 2)
    row, column = (grid.ravel() for grid in np.mgrid[0 : rings + 1, 0 : segments + 1])
    polar = row * (math.pi / rings)
    turn = column * (2 * math.pi / segments)
    # The last column repeats the positions of the first with u = 1; the positions are equal, so there is no gap.
    turn = np.where(column == segments, 0.0, turn)
    sine = np.where((row == 0) | (row == rings), 0.0, np.sin(polar))
    directions = np.stack([sine * np.sin(turn), np.cos(polar), sine * np.cos(turn)], axis=1)
    indices = []
    # Two triangles for each quad, but one at the poles.
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


@checked_keywords(who="shapes")
def plane(width: float = 1.0, depth: float | None = None) -> Mesh:
    """A rectangle around the origin that faces +y, such as a floor: width along x, depth along z (width), in meters.

    u grows along x, and v along z.
    """
    x, z = _sizes("plane", width=width, depth=width if depth is None else depth) / 2
    corners = np.array([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)])
    return Mesh(
        positions=corners * (x, 0, z),
        triangles=np.array([(0, 1, 2), (0, 2, 3)]),
        normals=np.tile((0.0, 1.0, 0.0), (4, 1)),
        uvs=((corners[:, ::2] + 1) / 2).astype(np.float32),
        name="plane",
    )


@checked_keywords(who="shapes")
def cylinder(radius: float = 0.5, height: float = 1.0, segments: int = 32) -> Mesh:
    """A closed cylinder around the origin, along y; lengths in meters. segments: at least 3, around."""
    r, y = _sizes("cylinder", radius=radius, height=height) * (1, 0.5)
    profile = [(0, y), (r, y), (r, y), (r, -y), (r, -y), (0, -y)]
    return revolved(profile, [(0, 1), (0, 1), (1, 0), (1, 0), (0, -1), (0, -1)], segments, "cylinder")


@checked_keywords(who="shapes")
def cone(radius: float = 0.5, height: float = 1.0, segments: int = 32) -> Mesh:
    """A closed cone around the origin: its tip is half the height above it, its base as far below; lengths in meters.
    segments: at least 3, around."""
    r, y = _sizes("cone", radius=radius, height=height) * (1, 0.5)
    side = height / math.hypot(height, radius), radius / math.hypot(height, radius)
    return revolved([(0, y), (r, -y), (r, -y), (0, -y)], [side, side, (0, -1), (0, -1)], segments, "cone")


@checked_keywords(who="shapes")
def capsule(radius: float = 0.25, height: float = 0.5, segments: int = 32) -> Mesh:
    """A cylinder along y with half spheres at its ends, around the origin; height: of the cylinder alone, in meters.

    segments: at least 3, around; half as many from pole to pole of both half spheres together.
    """
    _check_segments("capsule", segments)
    r, y = _sizes("capsule", radius=radius, height=height) * (1, 0.5)
    quarter = _arc(max(segments // 4, 1) * 4)[: max(segments // 4, 1) + 1]
    normals = np.concatenate([quarter, quarter[::-1] * (1, -1)])
    middle = np.repeat([y, -y], len(quarter))
    return revolved(r * normals + np.stack([0 * middle, middle], axis=1), normals, segments, "capsule")


@checked_keywords(who="shapes")
def torus(radius: float = 0.5, tube_radius: float = 0.2, segments: int = 48) -> Mesh:
    """A ring around the y axis: radius is that of the circle in the middle of its tube, in meters.

    segments: at least 6, around the axis; half as many around the tube. Raises SolariError if the tube is too thick.
    """
    _check_segments("torus", segments, 6)
    r, tube = _sizes("torus", radius=radius, tube_radius=tube_radius)
    if not tube < r:
        raise SolariError(f"a torus needs a tube_radius below its radius, not {tube_radius:g} and {radius:g}")
    circle = _arc(segments // 2)
    return revolved(tube * circle + (r, 0), circle, segments, "torus")


def _sizes(shape: str, **sizes: float) -> NDArray[np.float64]:
    """Lengths as an array. Raises SolariError for one that isn't a number above 0."""
    for name, size in sizes.items():
        if not isinstance(size, (int, float, np.number)) or not 0 < size < math.inf:
            raise SolariError(f"a {shape} needs a {name} above 0, not {quoted(size)}")
    return np.array(list(sizes.values()), np.float64)


def _check_segments(shape: str, segments: object, least: int = 3) -> None:
    if not isinstance(segments, (int, np.integer)) or segments < least:
        raise SolariError(f"a {shape} needs a whole number of at least {least} segments, not {quoted(segments)}")


def _arc(steps: int) -> NDArray[np.float64]:
    """Points (steps + 1, 2) of the unit circle, radius and height, from the top outwards and back, exactly closed."""
    turn = 2 * math.pi * (np.arange(steps + 1) % steps) / steps
    # Sine and cosine aren't exactly 0 at multiples of pi / 2, and the axis of a revolved shape must be.
    points = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    return np.where(np.abs(points) < 1e-12, 0, points)


def revolved(profile: ArrayLike, normals: ArrayLike, segments: int, name: str) -> Mesh:
    """What a profile makes that turns about the y axis: points (R, 2) of radius and height from the top down, on the
    outside, and their normals (R, 2). Equal points after each other are a sharp edge."""
    _check_segments(name, segments)
    points, outward = np.asarray(profile, np.float64), np.asarray(normals, np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    turn = 2 * math.pi * (np.arange(segments + 1) % segments) / segments  # the last column repeats the first
    around = np.stack([np.sin(turn), np.ones(segments + 1), np.cos(turn)], axis=1)
    indices = []
    for row in np.flatnonzero(steps > 0).tolist():
        for first in range(row * (segments + 1), row * (segments + 1) + segments):
            below = first + segments + 1
            # On the axis all points of a row are one: no triangle.
            if points[row + 1, 0] > 0:
                indices.append((first, below, below + 1))
            if points[row, 0] > 0:
                indices.append((first, below + 1, first + 1))
    u, v = np.meshgrid(np.arange(segments + 1) / segments, along)
    return Mesh(
        positions=(points[:, None, [0, 1, 0]] * around).reshape(-1, 3),
        normals=(outward[:, None, [0, 1, 0]] * around).reshape(-1, 3),
        uvs=np.stack([u, v], axis=-1).reshape(-1, 2),
        triangles=np.array(indices),
        name=name,
    )


if not TYPE_CHECKING:  # or checkers would take any name

    def __getattr__(name: str) -> NoReturn:
        raise unknown_attribute("shapes has no", name, lambda: __all__)


def __dir__() -> list[str]:
    return sorted(__all__)
