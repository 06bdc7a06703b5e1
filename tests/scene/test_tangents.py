"""Tangents equal MikkTSpace's: cases computed by hand, a plain transcription of its rules, and general properties."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solari_vk.scene.meshes.tangents import generate_tangents


def grid(size, seed=0):
    """A bumpy sheet with smooth normals and sheared uvs: positions, normals, uvs, triangles."""
    generator = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    height = 0.2 * np.sin(5 * u + generator.uniform()) * np.cos(4 * v)
    positions = np.stack([u, v, height], axis=-1).reshape(-1, 3).astype(np.float32)
    uvs = (np.stack([u + 0.3 * v, 1 - v + 0.1 * u * u], axis=-1).reshape(-1, 2)).astype(np.float32)
    first = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).reshape(-1)
    triangles = np.concatenate(
        [
            np.stack([first, first + 1, first + size], axis=1),
            np.stack([first + 1, first + size + 1, first + size], axis=1),
        ]
    )
    normals = np.zeros_like(positions)
    a, b, c = np.moveaxis(positions[triangles], 1, 0)
    cross = np.cross(b - a, c - a)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], cross)
    return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True), uvs, triangles


def by_corner(space):
    return space.tangents[space.indices]


# ---- the rules, one corner at a time ----------------------------------------------------------------


def transcription(positions, normals, uvs, triangles):
    """Tangents (M, 3, 4) by MikkTSpace's rules, computed corner by corner. All triangles must have an area."""
    frames = [triangle_frame(positions[t].astype(float), uvs[t].astype(float)) for t in triangles]
    result = np.zeros((len(triangles), 3, 4))
    for members in corner_groups(positions, normals, uvs, triangles, frames):
        total = np.zeros(3)
        for number, corner in members:
            total += corner_tangent(positions, normals, triangles[number], corner, frames[number][0])
        for number, corner in members:
            result[number, corner, :3] = total / np.linalg.norm(total)
            result[number, corner, 3] = -1 if frames[number][1] else 1  # glTF's sign, for v down
    return result


def triangle_frame(corners, uvs):
    """The unit direction in which u grows on a triangle, and whether its uvs run counterclockwise."""
    e1, e2 = corners[1:] - corners[0]
    (s1, t1), (s2, t2) = uvs[1:] - uvs[0]
    area = s1 * t2 - t1 * s2
    along_u = (t2 * e1 - t1 * e2) * (1 if area > 0 else -1)
    return along_u / np.linalg.norm(along_u), area > 0


def corner_groups(positions, normals, uvs, triangles, frames):
    """Lists of (triangle, corner) that share a tangent: corners with the same position, normal and uv, of triangles
    that meet at edges around them and whose uvs run the same way."""
    corner_key = [[tuple(map(float, (*positions[i], *normals[i], *uvs[i]))) for i in t] for t in triangles]
    edges = {}
    for number, keys in enumerate(corner_key):
        for corner in range(3):
            edges.setdefault((keys[corner], keys[(corner + 1) % 3]), []).append((number, corner))

    def neighbors(number, corner):
        """The same corner in the triangles across its two edges, which run through them the other way."""
        following, preceding = (corner + 1) % 3, (corner + 2) % 3
        keys = corner_key[number]
        for other, edge in edges.get((keys[following], keys[corner]), []):
            yield other, (edge + 1) % 3
        yield from edges.get((keys[corner], keys[preceding]), [])

    grouped = set()
    for start in ((number, corner) for number in range(len(triangles)) for corner in range(3)):
        group, waiting = [], [start]
        while waiting:
            where = waiting.pop()
            if where not in grouped and frames[where[0]][1] == frames[start[0]][1]:
                grouped.add(where)
                group.append(where)
                waiting.extend(neighbors(*where))
        if group:
            yield group


def corner_tangent(positions, normals, triangle, corner, along_u):
    """A triangle's part in the tangent of a corner: `along_u` in the normal's plane, weighted by the corner's angle."""
    n = normals[triangle[corner]].astype(float)
    sides = [positions[triangle[(corner + k) % 3]].astype(float) - positions[triangle[corner]] for k in (1, 2)]
    before, after = (v - n * (n @ v) for v in sides)
    cosine = before @ after / (np.linalg.norm(before) * np.linalg.norm(after))
    direction = along_u - n * (n @ along_u)
    return math.acos(np.clip(cosine, -1, 1)) * direction / np.linalg.norm(direction)


@pytest.mark.parametrize("seed", range(4))
def test_equal_to_the_rules_one_corner_at_a_time(seed):
    """Whatever the order of triangles and corners, with vertices that are shared or apart, and zeros of any sign."""
    positions, normals, uvs, triangles = grid(7, seed)
    generator = np.random.default_rng(seed)
    turns = generator.integers(0, 3, len(triangles))
    triangles = np.stack([np.roll(t, n) for t, n in zip(triangles, turns, strict=True)])
    triangles = triangles[generator.permutation(len(triangles))]
    if seed % 2:  # islands: some triangles get uvs of their own, some of them mirrored
        positions, normals = positions[triangles].reshape(-1, 3), normals[triangles].reshape(-1, 3)
        positions[(positions == 0) & (generator.random(positions.shape) < 0.5)] = -0.0
        uvs = uvs[triangles]
        chosen = generator.random(len(triangles)) < 0.3
        uvs[chosen] = uvs[chosen] * [-1, 1] + [5, 0]
        turned = generator.random(len(triangles)) < 0.2
        uvs[turned] = uvs[turned][..., ::-1]
        uvs = uvs.reshape(-1, 2)
        triangles = np.arange(len(positions)).reshape(-1, 3)
    space = generate_tangents(positions, normals, uvs, triangles)
    expected = transcription(positions, normals, uvs, triangles)
    np.testing.assert_allclose(by_corner(space), expected, atol=2e-5)
    assert seed % 2 or len(space.source) == len(positions), "a smooth sheet needs no splits"


# ---- by hand ----------------------------------------------------------------------------------------

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
UP = np.tile(np.float32([0, 0, 1]), (4, 1))
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("uvs", "tangent"),
    [
        ([[0, 1], [1, 1], [1, 0], [0, 0]], [1, 0, 0, 1]),  # upright image: v down, so up is +y
        ([[1, 1], [0, 1], [0, 0], [1, 0]], [-1, 0, 0, -1]),  # mirrored
        ([[0, 0], [0, 1], [1, 1], [1, 0]], [0, 1, 0, 1]),  # turned by a quarter
        ([[0, 2], [1, 2], [1, 0], [0, 0]], [1, 0, 0, 1]),
    ],
)
def test_a_square(uvs, tangent):
    space = generate_tangents(SQUARE, UP, np.array(uvs, np.float32), HALVES)
    np.testing.assert_allclose(space.tangents, [tangent] * 4, atol=1e-6)
    assert space.source[space.indices].tolist() == HALVES.tolist()
    # The bitangent points upwards in the image, the direction in which v decreases.
    bitangent = np.cross(UP[0], space.tangents[0, :3]) * space.tangents[0, 3]
    slope = np.linalg.lstsq(SQUARE[:, :2] - SQUARE[0, :2], np.float32(uvs)[:, 1] - np.float32(uvs)[0, 1], rcond=None)[0]
    assert bitangent[:2] @ slope < 0


def test_the_mean_is_weighted_by_angle():
    """Two triangles share a vertex, with angles of 90 and 45 degrees there; u increases in different directions."""
    positions = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 1, 0]])
    uvs = np.float32([[0, 0], [1, 0], [0, 1], [-1, 0]])
    # In the first triangle u = x and v = y; in the second u = x and v = x + y.
    second = np.array([1, -1]) / math.sqrt(2)  # the direction in which u increases and v is constant
    expected = math.pi / 2 * np.array([1, 0]) + math.pi / 4 * second
    space = generate_tangents(positions, UP, uvs, np.array([[0, 1, 2], [0, 2, 3]]))
    assert len(space.source) == 4
    np.testing.assert_allclose(space.tangents[0, :2], expected / np.linalg.norm(expected), atol=1e-6)
    uvs[3] = [1, 2]  # now the second is mirrored: two groups, so the shared vertices split
    assert len(generate_tangents(positions, UP, uvs, np.array([[0, 1, 2], [0, 2, 3]])).source) == 6


def test_triangles_without_uv_area_or_area_join_others():
    positions = np.vstack([SQUARE, [[0, 2, 0]]]).astype(np.float32)
    uvs = np.float32([[0, 1], [1, 1], [1, 0], [0, 0], [0.5, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4]])
    space = generate_tangents(positions, np.tile(UP[0], (5, 1)), uvs, triangles)
    np.testing.assert_allclose(by_corner(space)[2, :2], [[1, 0, 0, 1]] * 2, atol=1e-6)
    assert len(space.source) == 5
    # A triangle without an area takes the tangent of its vertex.
    space = generate_tangents(SQUARE, UP, uvs[:4], np.array([[1, 1, 2], [0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(space.tangents, [[1, 0, 0, 1]] * 4, atol=1e-6)


def test_equal_uvs_and_zero_normals():
    """With equal uvs, tangents are any unit vectors orthogonal to the normals; with zero normals they are finite."""
    space = generate_tangents(SQUARE, UP, np.zeros((4, 2), np.float32), HALVES)
    np.testing.assert_allclose(np.linalg.norm(space.tangents[:, :3], axis=1), 1)
    np.testing.assert_allclose((space.tangents[:, :3] * UP[space.source]).sum(axis=1), 0, atol=1e-6)
    space = generate_tangents(SQUARE, UP * 0, np.zeros((4, 2), np.float32), HALVES)
    assert np.isfinite(space.tangents).all()
    assert generate_tangents(SQUARE, UP, SQUARE[:, :2], np.zeros((0, 3), int)).tangents.shape == (0, 4)


@pytest.mark.parametrize("scale", [1e-12, 1e15])
def test_the_scale_has_no_effect(scale):
    positions, normals, uvs, triangles = grid(9)
    expected = by_corner(generate_tangents(positions, normals, uvs, triangles))
    scaled = generate_tangents((positions * scale).astype(np.float32), normals, uvs, triangles)
    np.testing.assert_allclose(by_corner(scaled), expected, atol=1e-4)


def test_more_than_two_triangles_on_an_edge():
    generator = np.random.default_rng(7)
    positions = generator.normal(size=(12, 3)).astype(np.float32)
    triangles = np.array([[0, 1, n] if n % 2 else [1, 0, n] for n in range(2, 12)])
    normals = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    space = generate_tangents(positions, normals, generator.random((12, 2)).astype(np.float32), triangles)
    assert np.isfinite(space.tangents).all()
    assert space.source[space.indices].tolist() == triangles.tolist()
