"""Meshes of MuJoCo's geoms, in the geom's own frame, whose z axis points up, with texture coordinates as MuJoCo has
them: the pictures of its renderer show the same texels at the same places."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.meshes.smoothing import smooth_normals
from solari_vk.scene.model import Mesh

Floats = NDArray[Any]
UP = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])
"""From MuJoCo's axes, z up, to the scene's, y up."""
FACE_MARGIN = 1 / 16
"""Of the width of a cube map's face, which is repeated around it in `surfaces.cube_atlas`."""
INFINITE = 2.0  # times the distance at which MuJoCo's cameras end: half the width of a plane without end
_SEGMENTS = 48
_LINE_RADIUS = 1e-3  # meters: MuJoCo has lines in pixels
_ON_EDGE = 1e-5  # of the largest coordinate: positions have 24 bits
_SMALLEST = 1e-6  # of what MuJoCo draws without a length

# OpenGL 4.6, table 8.19, in the order of MuJoCo's faces: right, left, up, down, front, back; the axes along which the
# face's columns and rows run.
CUBE_FACES = (
    ((0, 0, -1), (0, -1, 0)), ((0, 0, 1), (0, -1, 0)), ((1, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, -1, 0)), ((-1, 0, 0), (0, -1, 0)),
)  # fmt: skip


def primitive(kind: str, size: Floats, far: float) -> Mesh:
    """A mesh of a geom that isn't a mesh of the model: kind: of mjtGeom without its prefix. far: the distance at which
    cameras end."""
    size = np.where(size > 0, size, _SMALLEST) if kind != "PLANE" else size
    if kind == "PLANE":
        return _plane(size[:2], INFINITE * far)
    if kind in ("SPHERE", "ELLIPSOID"):
        return _spherical(size)
    if kind == "BOX":
        return _box(size)
    if kind == "CAPSULE":
        return upright(shapes.capsule(size[0], 2 * size[2], _SEGMENTS))
    if kind == "CYLINDER":
        return upright(shapes.cylinder(size[0], 2 * size[2], _SEGMENTS))
    if kind.startswith("ARROW"):
        return _arrow(size, kind)
    if kind == "LINE":
        return upright(shapes.cylinder(_LINE_RADIUS, size[2], 8), lift=size[2] / 2)
    raise SolariError(f"MuJoCo: geoms of the kind {kind.lower()} have no mesh here")


def _plane(half: Floats, endless: float) -> Mesh:
    """half: of the width and the height; where it is 0, they have no end, and a picture covers two units of length."""
    ends = half > 0
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.where(ends, half, endless)
    positions = np.column_stack([corners, np.zeros(4)])
    uvs: Floats = (corners / np.where(ends, half, 1) * (1, -1) + ends) / 2
    normals = np.tile((0.0, 0.0, 1.0), (4, 1))
    return Mesh(positions, np.array([(0, 1, 2), (0, 2, 3)]), normals=normals, uvs=uvs, name="plane")


def _spherical(size: Floats) -> Mesh:
    """u runs around the z axis from x to y, v from the upper pole down."""
    unit = upright(shapes.sphere(1.0, _SEGMENTS))
    around = unit.uvs
    assert around is not None
    # shapes.sphere begins a quarter of a turn later.
    uvs: Floats = np.column_stack([around[:, 0] - 0.25, around[:, 1]])
    normals: Floats = unit.positions / size
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(unit.positions * size, unit.triangles, normals=normals, uvs=uvs, name="ellipsoid")


def _box(size: Floats) -> Mesh:
    """Each side has the whole picture."""
    rows = [(column, row, np.cross(row, column)) for column, row in CUBE_FACES]
    positions, normals = [], []
    for column, row, normal in rows:
        for u, v in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
            positions.append(np.array(normal) + u * np.array(column) + v * np.array(row))
            normals.append(normal)
    triangles = [(4 * side + a, 4 * side + b, 4 * side + c) for side in range(6) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    uvs = np.tile([(0, 0), (0, 1), (1, 1), (1, 0)], (6, 1))
    return Mesh(np.array(positions) * size, np.array(triangles), normals=np.array(normals, float), uvs=uvs, name="box")


def upright(mesh: Mesh, lift: float = 0.0) -> Mesh:
    """A shape about the y axis, about the z axis."""
    normals = None if mesh.normals is None else mesh.normals @ UP
    return Mesh(mesh.positions @ UP + (0, 0, lift), mesh.triangles, normals=normals, uvs=mesh.uvs, name=mesh.name)


def _arrow(size: Floats, kind: str) -> Mesh:
    """A shaft and a tip from the origin along z, as long as the third size."""
    radius, length = size[0], size[2]
    shaft = upright(shapes.cylinder(radius, 0.8 * length, 16), lift=0.4 * length)
    tip = upright(shapes.cone(1.75 * radius, 0.2 * length, 16), lift=0.9 * length)
    positions = np.concatenate([shaft.positions, tip.positions])
    triangles = np.concatenate([shaft.triangles, tip.triangles + len(shaft.positions)])
    assert shaft.normals is not None
    assert tip.normals is not None
    return Mesh(positions, triangles, normals=np.concatenate([shaft.normals, tip.normals]), name=kind.lower())


def model_mesh(model: Any, index: int) -> Mesh:
    """A mesh of the model, with its normals and texture coordinates."""
    vertices = model.mesh_vert[model.mesh_vertadr[index] :][: model.mesh_vertnum[index]]
    faces = slice(model.mesh_faceadr[index], model.mesh_faceadr[index] + model.mesh_facenum[index])
    columns = [model.mesh_face[faces].reshape(-1)]
    has_normals = model.mesh_normaladr[index] >= 0 and model.mesh_normalnum[index] > 0
    has_uvs = model.mesh_texcoordadr[index] >= 0
    if has_normals:
        columns.append(model.mesh_facenormal[faces].reshape(-1))
    if has_uvs:
        columns.append(model.mesh_facetexcoord[faces].reshape(-1))
    # Each corner has a row of each array; equal corners become one vertex.
    corners, numbers = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)
    triangles: Floats = numbers.reshape(-1, 3)
    normals = uvs = None
    if has_normals:
        normals = _unit(model.mesh_normal[model.mesh_normaladr[index] :][corners[:, 1]])
    if has_uvs:
        uvs = np.nan_to_num(model.mesh_texcoord[model.mesh_texcoordadr[index] :][corners[:, -1]])
    return Mesh(
        vertices[corners[:, 0]], triangles.reshape(-1, 3), normals=normals, uvs=uvs, name=model.mesh(index).name
    )


def height_field(model: Any, index: int) -> Mesh:
    """The surface of a height field, with sides down to its base."""
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    x, y, top, base = model.hfield_size[index]
    start = model.hfield_adr[index]
    heights = top * model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(1, 0, rows))
    positions = np.stack([x * (2 * u - 1), y * (1 - 2 * v), heights], axis=-1).reshape(-1, 3)
    numbers = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.reshape(-1) for part in (numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    # Counter-clockwise from above, so that the sides look outwards.
    border = np.concatenate([numbers[0, :-1], numbers[:-1, -1], numbers[-1, :0:-1], numbers[:0:-1, 0]])
    side, side_triangles = _sides(positions[border], -base)
    source, normals, triangles = smooth_normals(positions, triangles)
    positions, uvs = positions[source], uvs[source]
    flat_normals = _unit(np.cross(side[1::3] - side[::3], side[2::3] - side[::3])).repeat(3, axis=0)
    return Mesh(
        np.concatenate([positions, side]),
        np.concatenate([triangles, side_triangles + len(positions)]),
        normals=np.concatenate([normals, flat_normals]),
        uvs=np.concatenate([uvs, np.zeros((len(side), 2))]),
        name=model.hfield(index).name,
    )


def _sides(border: Floats, bottom: float) -> tuple[Floats, NDArray[Any]]:
    """Walls below a closed line of points, each triangle with vertices of its own."""
    after = np.roll(border, -1, axis=0)
    low, low_after = border.copy(), after.copy()
    low[:, 2] = low_after[:, 2] = bottom
    corners = np.stack([border, low, low_after, border, low_after, after], axis=1).reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def soft_mesh(model: Any, visual: Any, kind: str, number: int) -> Mesh | None:
    """A flex or a skin as it is now, in MuJoCo's world; None for a flex that is drawn without faces. visual: the
    MjvScene of the state."""
    if kind == "FLEX":
        start, count = int(visual.flexfaceadr[number]), int(visual.flexfaceused[number])
        corners, normals = (
            values[9 * start :][: 9 * count].reshape(-1, 3) for values in (visual.flexface, visual.flexnormal)
        )
        # MuJoCo leaves these as they were in memory for a flex without any.
        has_uvs = model.flex_texcoordadr[number] >= 0
        uvs = visual.flextexcoord[6 * start :][: 6 * count].reshape(-1, 2) if has_uvs else None
        return Mesh(corners, normals=_unit(normals), uvs=uvs, name="flex") if count else None
    start, count = int(visual.skinvertadr[number]), int(visual.skinvertnum[number])
    positions, normals = (
        values[3 * start :][: 3 * count].reshape(-1, 3) for values in (visual.skinvert, visual.skinnormal)
    )
    first = int(model.skin_texcoordadr[number])
    uvs = model.skin_texcoord[first:][:count] if first >= 0 else None
    faces = model.skin_face[int(model.skin_faceadr[number]) :][: int(model.skin_facenum[number])]
    return Mesh(positions, faces, normals=_unit(normals), uvs=uvs, name=model.skin(number).name)


def _unit(normals: Floats) -> Floats:
    """Unit vectors, upwards where there is none."""
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    found: Floats = np.where(lengths > 1e-12, normals / np.maximum(lengths, 1e-12), (0.0, 0.0, 1.0))
    return found


def with_cube_uvs(mesh: Mesh, scale: Floats) -> Mesh:
    """A mesh whose uvs look up `surfaces.cube_atlas` in the direction of each point from the origin, divided by a
    scale. Triangles are split where another face of the cube begins."""
    normals = mesh.normals if mesh.normals is not None else np.zeros_like(mesh.positions)
    # Of each corner of each triangle the direction, the position and the normal.
    directions = mesh.positions / scale
    directions = directions / max(float(np.abs(directions).max()), 1e-12)
    values = np.concatenate([directions, mesh.positions, normals], axis=1)
    corners: Floats = values[mesh.triangles].astype(np.float64)
    for first, second in combinations(range(3), 2):
        for sign in (-1, 1):
            corners = _split(corners, corners[..., first] + sign * corners[..., second])
    places = corners[..., 3:6]
    sides = places[:, 1:] - places[:, :1]
    corners = corners[np.cross(sides[:, 0], sides[:, 1]).any(axis=1)]  # a cut through a corner leaves some without area
    middle = corners[..., :3].mean(axis=1)
    axis = np.abs(middle).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(middle, axis[:, None], 1)[:, 0] < 0)
    column, row = (np.array([axes[i] for axes in CUBE_FACES], np.float64)[face] for i in range(2))
    depth = np.abs(np.take_along_axis(corners[..., :3], axis[:, None, None], 2)[..., 0])
    share = [np.einsum("tck,tk->tc", corners[..., :3], along) / np.maximum(depth, 1e-12) for along in (column, row)]
    u, v = ((np.clip(part, -1, 1) + 1) / 2 for part in share)
    height = 1 + 2 * FACE_MARGIN
    uvs = np.stack([(u + FACE_MARGIN) / height, (face[:, None] * height + v + FACE_MARGIN) / (6 * height)], axis=-1)
    given = corners[..., 6:].reshape(-1, 3) if mesh.normals is not None else None
    return Mesh(corners[..., 3:6].reshape(-1, 3), normals=given, uvs=uvs.reshape(-1, 2), name=mesh.name)


def _split(corners: Floats, side: Floats) -> Floats:
    """Triangles (T, 3, K), those split that cross the plane where `side` (T, 3), a linear function, is 0."""
    side = np.where(np.abs(side) < _ON_EDGE, 0.0, side)
    crosses = (side.max(axis=1) > 0) & (side.min(axis=1) < 0)
    cut, values = corners[crosses], side[crosses]
    # Turn each triangle until the first corner is alone on its side of the plane.
    signs = np.sign(values)
    wanted = np.where(signs.sum(axis=1) <= 0, 1, -1)
    alone = (signs == wanted[:, None]).argmax(axis=1)
    turn = (alone[:, None] + np.arange(3)) % 3
    cut = np.take_along_axis(cut, turn[:, :, None], axis=1)
    values = np.take_along_axis(values, turn, axis=1)
    a, b, c = cut[:, 0], cut[:, 1], cut[:, 2]
    near_b = _crossing(a, b, values[:, 0], values[:, 1])
    near_c = _crossing(a, c, values[:, 0], values[:, 2])
    parts = [np.stack(part, axis=1) for part in ((a, near_b, near_c), (near_b, b, c), (near_b, c, near_c))]
    return np.concatenate([corners[~crosses], *parts])


def _crossing(a: Floats, b: Floats, side_a: Floats, side_b: Floats) -> Floats:
    share = (side_a / (side_a - side_b))[:, None]
    found: Floats = a + share * (b - a)
    return found
