"""Tangents for normal maps, as MikkTSpace makes them.

Follows Mikkelsen, "Simulation of Wrinkled Surfaces Revisited" (2008) and the rules of its mikktspace.c, whole
arrays at a time: vertices of equal position, normal and uv are one; around each, triangles that share edges
and the uv's orientation form a group; a group's tangent is the mean of its triangles' uv directions in the
vertex's tangent plane, weighted by angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.matrices import orthogonal, unit

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_TINY = float(np.finfo(np.float32).tiny)


@dataclass
class TangentSpace:
    """Vertices split where tangents differ: row i is the given vertex source[i] with the tangent tangents[i]."""

    source: Integers  # (K,)
    tangents: NDArray[np.float32]  # (K, 4): unit, orthogonal to the normal; w * cross(normal, xyz) points up the image
    indices: NDArray[np.uint32]  # (M, 3) into source


def generate_tangents(
    positions: NDArray[Any], normals: NDArray[Any], uvs: NDArray[Any], triangles: NDArray[Any]
) -> TangentSpace:
    """Tangents of triangles (M, 3) over vertices (N, 3), unit normals (N, 3) and uvs (N, 2), v down as in glTF.

    Where mikktspace.c leaves a constant, at corners that no triangle with a uv area reaches, the tangent is
    some unit vector orthogonal to the normal.
    """
    triangles = triangles.astype(np.int64)
    corners = triangles.reshape(-1)
    welded_of = weld(np.hstack([positions, normals, uvs]))
    welded = welded_of[triangles]
    position, normal = np.asarray(positions, np.float64), np.asarray(normals, np.float64)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        along_u, preserving, has_uv = _uv_directions(position[triangles], np.asarray(uvs, np.float64)[triangles])
        solid = ~_has_equal_corners(weld(positions)[triangles])
        neighbor = neighbors(welded, solid)
        preserving = _orient_without_uv(preserving, has_uv, neighbor)
        group = _groups(preserving, neighbor)
        # Triangles without area have no own groups: their corners join a group of the same vertex if there is one.
        first = np.full(len(welded_of), -1, np.int64)
        solid_corners = np.flatnonzero(np.repeat(solid & has_uv, 3))[::-1]
        first[welded.reshape(-1)[solid_corners]] = group[solid_corners]
        flat_corners = np.flatnonzero(np.repeat(~solid, 3))
        known = first[welded.reshape(-1)[flat_corners]]
        group[flat_corners] = np.where(known >= 0, known, group[flat_corners])

        weight = _corner_angles(position[triangles], normal[triangles]) * (solid & has_uv)[:, None]
        directions = unit(_project(along_u[:, None, :], normal[triangles]))
        summed: Floats = np.stack(
            [np.bincount(group, (weight * directions[..., axis]).reshape(-1), len(group)) for axis in range(3)], axis=1
        )
    # All corners with the same vertex and group become one vertex of the result.
    split = corners * np.int64(len(corners)) + group
    _, first_corner, inverse = np.unique(split, return_index=True, return_inverse=True)
    source = corners[first_corner]
    tangent = _orthonormal(summed[group[first_corner]], normal[source])
    # In glTF v increases downwards in the image, but the green channel of a normal map points upwards.
    sign = np.where(preserving[group[first_corner] // 3], -1.0, 1.0)
    result = np.hstack([tangent, sign[:, None]]).astype(np.float32)
    return TangentSpace(source, result, inverse.reshape(-1, 3).astype(np.uint32))


def fitted_tangents(tangents: NDArray[Any], normals: NDArray[Any]) -> NDArray[np.float32]:
    """Unit tangents with w = -1 or 1. Any direction orthogonal to the normal replaces a missing tangent."""
    fitted = np.empty(tangents.shape, np.float32)
    fitted[:, :3] = unit(tangents[:, :3])
    fitted[:, 3] = np.where(tangents[:, 3] < 0, -1, 1)
    missing = ~fitted[:, :3].any(axis=1)
    fitted[missing, :3] = orthogonal(normals[missing])
    return fitted


def weld(rows: NDArray[Any]) -> Integers:
    """An index (N,) for each row of floats (N, K); exactly equal rows have the same index."""
    bits = np.ascontiguousarray(np.asarray(rows, np.float32) + np.float32(0)).view(np.uint32)  # + 0: -0 equals 0
    # Sorting one hash is faster than sorting rows. The constant is that of Fibonacci hashing, 2^64 over the golden
    # ratio.
    key = np.zeros(len(bits), np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    if not np.array_equal(bits[first][inverse], bits):  # a collision of the hash: compare the rows themselves
        _, inverse = np.unique(bits, axis=0, return_inverse=True)
    return inverse.reshape(-1).astype(np.int64)


def _uv_directions(points: Floats, uv: Floats) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """For each triangle: the direction of increasing u, whether uv preserves the winding, whether uv has an area."""
    edge1, edge2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    (s1, t1), (s2, t2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    # Twice the signed area in uvs: its sign says whether the image is mirrored.
    area = s1 * t2 - t1 * s2
    along_u = t2[:, None] * edge1 - t1[:, None] * edge2
    along_v = s1[:, None] * edge2 - s2[:, None] * edge1
    preserving = area > 0
    lengths = np.stack([np.linalg.norm(along_u, axis=1), np.linalg.norm(along_v, axis=1)])
    has_uv = (np.abs(area) > _TINY) & (lengths / np.abs(area) > _TINY).all(axis=0) & np.isfinite(lengths).all(axis=0)
    return along_u * np.where(preserving, 1.0, -1.0)[:, None], preserving, has_uv


def _has_equal_corners(positions: Integers) -> NDArray[np.bool_]:
    a, b, c = positions.T
    equal: NDArray[np.bool_] = (a == b) | (b == c) | (c == a)
    return equal


def neighbors(welded: Integers, solid: NDArray[np.bool_]) -> Integers:
    """For each edge, from corner i to i + 1 of a triangle, the edge (3 * triangle + corner) of its neighbor, or -1.

    Neighbors' edges run in opposite directions. Where more than two edges meet, the k-th of one direction is paired
    with the k-th of the other.
    """
    start, end = welded.reshape(-1), np.roll(welded, -1, axis=1).reshape(-1)
    edges = np.flatnonzero(np.repeat(solid, 3))
    start, end = start[edges], end[edges]
    key = np.minimum(start, end) * (welded.max(initial=0) + 1) + np.maximum(start, end)
    sides = []
    for side in (start < end, start > end):
        order = np.flatnonzero(side)
        order = order[np.argsort(key[order], kind="stable")]
        sides.append((key[order], edges[order]))
    (keys_a, edges_a), (keys_b, edges_b) = sides
    # Where several edges have one key, the number among them.
    rank = np.arange(len(keys_a)) - np.searchsorted(keys_a, keys_a)
    # The partner of the k-th edge with some key is the k-th edge with that key on the other side.
    place = np.searchsorted(keys_b, keys_a) + rank
    matched = place < len(keys_b)
    matched[matched] = keys_b[place[matched]] == keys_a[matched]
    neighbor = np.full(welded.size, -1, np.int64)
    neighbor[edges_a[matched]] = edges_b[place[matched]]
    neighbor[edges_b[place[matched]]] = edges_a[matched]
    return neighbor


def _orient_without_uv(
    preserving: NDArray[np.bool_], has_uv: NDArray[np.bool_], neighbor: Integers
) -> NDArray[np.bool_]:
    """Triangles without a uv area take the orientation of a neighbor, so that groups reach across them."""
    preserving, oriented = preserving.copy(), has_uv.copy()
    across = np.where(neighbor >= 0, neighbor // 3, -1).reshape(-1, 3)
    # Each round reaches one triangle farther; longer strips without uvs keep their own orientation.
    for _ in range(64):
        unoriented = np.flatnonzero(~oriented)
        known = (across[unoriented] >= 0) & oriented[across[unoriented]]
        reached = known.any(axis=1)
        if not reached.any():
            break
        donor = across[unoriented, np.argmax(known, axis=1)][reached]
        preserving[unoriented[reached]] = preserving[donor]
        oriented[unoriented[reached]] = True
    return preserving


def _groups(preserving: NDArray[np.bool_], neighbor: Integers) -> Integers:
    """The group of each corner (3M,), named by its lowest corner."""
    edge = np.flatnonzero(neighbor > np.arange(len(neighbor)))
    other = neighbor[edge]
    same = preserving[edge // 3] == preserving[other // 3]
    edge, other = edge[same], other[same]
    # An edge's start is the other's end: both pairs of corners are linked.
    ends = np.concatenate([next_corner(other), other])
    return components(len(neighbor), np.concatenate([edge, next_corner(edge)]), ends)


def components(count: int, a: Integers, b: Integers) -> Integers:
    """The connected component of each of `count` things, named by its lowest: a[i] is linked with b[i]."""
    label = np.arange(count, dtype=np.int64)
    while True:
        low, high = np.minimum(label[a], label[b]), np.maximum(label[a], label[b])
        apart = low != high
        if not apart.any():
            return label
        # Link the higher label to the lower one, then let all labels name the root of their chain.
        np.minimum.at(label, high[apart], low[apart])
        label = _shortened(label)
        a, b = a[apart], b[apart]


def _shortened(label: Integers) -> Integers:
    """Labels that name the root of each chain of labels: pointer jumping."""
    while True:
        jumped = label[label]
        if np.array_equal(label, jumped):
            return label
        label = jumped


def next_corner(corner: Integers) -> Integers:
    """The corner after each corner in its triangle."""
    return np.where(corner % 3 == 2, corner - 2, corner + 1)


def _corner_angles(points: Floats, normals: Floats) -> Floats:
    """The angle (M, 3) of each corner, measured in the plane orthogonal to its normal."""
    before = unit(_project(np.roll(points, 1, axis=1) - points, normals))
    after = unit(_project(np.roll(points, -1, axis=1) - points, normals))
    angles: Floats = np.arccos(np.clip((before * after).sum(axis=-1), -1, 1))
    return angles


def _project(vectors: Floats, normals: Floats) -> Floats:
    inside: Floats = vectors - (vectors * normals).sum(axis=-1, keepdims=True) * normals
    return inside


def _orthonormal(tangents: Floats, normals: Floats) -> Floats:
    """Unit tangents orthogonal to the normals. Any direction orthogonal to the normal replaces a missing tangent."""
    missing = np.linalg.norm(tangents, axis=1, keepdims=True) < 1e-6
    return np.where(missing, orthogonal(normals), unit(_project(tangents, normals)))
