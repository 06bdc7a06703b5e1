"""Parts of OBJ, PLY and STL files: polygons as triangles, and colors, uvs and textures as each format says them."""

from __future__ import annotations

import re
import warnings
from bisect import bisect
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.mtl import MtlFiles
from solari_vk.scene.files.ply import Element, Lists, read_ply
from solari_vk.scene.meshes.polygons import triangulate
from solari_vk.scene.model import Material

_FACE = re.compile(rb"(?m)^f[ \t]+([^\n#]*)")
_NO_TRIANGLE = re.compile(rb"(?m)^f(?:(?:[ \t]+\S+){4}|[^\n]*-|(?:[ \t]+\S+){0,2}[ \t]*$)")
_INDEX_0 = re.compile(rb"(?m)^f[^\n]*[ \t/]0+(?![^\s/])")
_VERTEX = re.compile(rb"(?m)^v[ \t]")
_POSITION = re.compile(rb"(?m)^v[ \t]+(\S+[ \t]+\S+[ \t]+\S+)")
_OTHER_NUMBERS = re.compile(rb"/\S*")
_BYTES_PER_LINE, _BYTES_PER_WORD = 500, 100  # of .obj files that have polygons
_MOST_DIGITS = 18  # of a number of 64 bits
_VERTEX_LISTS = ("vertex_indices", "vertex_index")
_NORMAL = ("nx", "ny", "nz")
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))


@dataclass
class MeshPart:
    """What becomes a mesh: vertices (N, 3), triangles (M, 3), and what a file has for each vertex."""

    name: str
    positions: Any
    triangles: NDArray[np.int64]
    normals: Any = None
    colors: Any = None
    """sRGB: integers from 0 to 255, or floats from 0 to 1."""
    uvs: Any = None
    """v increases upwards."""
    material: Material | None = None

    def spread(self, corners: NDArray[np.int64]) -> None:
        """Give each corner a vertex of its own. corners: the vertices (K,) until now."""
        for name in ("positions", "normals", "colors", "uvs"):
            values = getattr(self, name)
            setattr(self, name, None if values is None else values[corners])


def triangulated_obj(data: bytes, who: str) -> bytes:
    """An .obj file whose faces are triangles, which number vertices from the start of the file."""
    if _INDEX_0.search(data):  # which trimesh would take for the last vertex
        raise SolariError(
            f"{who}: has a face with an index of 0, but indices of .obj files begin at 1: export it again"
        )
    if not _NO_TRIANGLE.search(data):
        return data
    charge(0, who, "its polygons", working=_BYTES_PER_LINE * data.count(b"\n") + _BYTES_PER_WORD * data.count(b" "))
    lines = list(_FACE.finditer(data))
    faces = [line[1].split() for line in lines]
    counts = np.array([len(face) for face in faces], np.int64)
    is_changed = (counts < 3) | (counts > 4)
    if any(b"-" in line[1] for line in lines):
        starts = [
            [line.start() for line in re.finditer(rb"(?m)^%s[ \t]" % kind, data)] for kind in (b"v", b"vt", b"vn")
        ]
        faces = [[_absolute(corner, line.start(), starts) for corner in line[1].split()] for line in lines]
        is_changed[:] = True
    corners = list(chain.from_iterable(faces))
    triangles = triangulate(_points(data, corners, who), counts, who)
    face_of = np.repeat(np.arange(len(faces)), counts)[triangles[:, 0]]
    # Readers cut polygons of four corners at the first one, so most stay as they are.
    is_changed[face_of[triangles[:, 0] != (np.cumsum(counts) - counts)[face_of]]] = True
    made: dict[int, list[bytes]] = {number: [] for number in np.flatnonzero(is_changed).tolist()}
    is_new = is_changed[face_of]
    for number, triangle in zip(face_of[is_new].tolist(), triangles[is_new].tolist(), strict=True):
        made[number].append(b"f " + b" ".join(corners[corner] for corner in triangle))
    pieces = []
    end = 0
    for number, new in made.items():
        pieces += [data[end : lines[number].start()], b"\n".join(new)]
        end = lines[number].end()
    return b"".join((*pieces, data[end:]))


def _points(data: bytes, corners: list[bytes], who: str) -> NDArray[np.float64]:
    """The places (K, 3) of corners of faces in an .obj file."""
    rows = _POSITION.findall(data)
    try:
        with warnings.catch_warnings(action="error"):  # versions of numpy warn of what is no number, or refuse it
            points = np.fromstring(b" ".join(rows), np.float64, sep=" ").reshape(-1, 3)
            numbers = np.fromstring(_OTHER_NUMBERS.sub(b"", b" ".join(corners)), np.int64, sep=" ")
    except (ValueError, DeprecationWarning):
        points, numbers = np.zeros((0, 3)), np.zeros(0, np.int64)
    if len(numbers) != len(corners) or len(points) != len(_VERTEX.findall(data)):
        raise SolariError(f"{who}: a damaged .obj file, with words where numbers should be: export it again")
    return np.asarray(points[_checked(numbers - 1, len(points), who)])


def _checked(numbers: NDArray[Any], count: int, who: str) -> NDArray[np.int64]:
    """Numbers of vertices, of which there are `count`."""
    with np.errstate(invalid="ignore"):  # NaN becomes no vertex's number
        found = numbers.astype(np.int64)
    if found.size and (found.min() < 0 or found.max() >= count):
        raise SolariError(f"{who}: has faces of vertices that don't exist: export the file again")
    return found


def _absolute(corner: bytes, place: int, starts: list[list[int]]) -> bytes:
    """A face's corner, whose numbers below 0 count back from its place in the file."""
    if b"-" not in corner:
        return corner
    numbers = corner.split(b"/")
    for kind, number in enumerate(numbers[:3]):
        if number.startswith(b"-") and number[1:].isdigit() and len(number) <= _MOST_DIGITS:
            numbers[kind] = b"%d" % (bisect(starts[kind], place) + 1 + int(number))
    return b"/".join(numbers)


def stl_colors(part: dict[str, Any], data: bytes) -> NDArray[np.int64] | None:
    """Colors of vertices from the two bytes that binary .stl files have for each triangle, as VisCAM writes them, or as
    Magics does, which names the color of the rest in the header."""
    words = part.get("face_attributes", {}).get("stl")
    if words is None:
        return None
    words = np.asarray(words, np.int64).reshape(-1)
    at = data[:80].find(b"COLOR=")
    own = (words & 0x8000 != 0) == (at < 0)
    if at < 0 and not own.any():
        return None
    rest = (255, 255, 255) if at < 0 else tuple(data[at + 6 : at + 9])
    shifts = (10, 5, 0) if at < 0 else (0, 5, 10)
    colors = np.stack([np.rint((words >> shift & 31) * (255 / 31)).astype(np.int64) for shift in shifts], axis=1)
    return np.repeat(np.where(own[:, None], colors, rest), 3, axis=0)


@dataclass
class _Fields:
    """An element's values, and which of them nobody has asked for."""

    name: str
    element: Element
    asked: set[str] = field(default_factory=set)

    def columns(self, *choices: tuple[str, ...]) -> NDArray[Any] | None:
        """The numbers (N, K) of the first of several sets of properties that is there."""
        for names in choices:
            columns = [self.element.values.get(name) for name in names]
            self.asked.update(names)
            if all(isinstance(column, np.ndarray) for column in columns):
                return np.stack([column for column in columns if isinstance(column, np.ndarray)], axis=1)
        return None

    def lists(self, *names: str) -> Lists | None:
        """The first of several properties that is there."""
        self.asked.update(names)
        found = (self.element.values.get(name) for name in names)
        return next((values for values in found if isinstance(values, Lists)), None)

    def ignored(self) -> list[str]:
        """The properties that have no effect. An alpha that is the same everywhere is as good as none."""
        alpha = self.element.values.get("alpha")
        same = {"alpha"} if isinstance(alpha, np.ndarray) and not np.ptp(alpha) else set()
        return [f"{name} of {self.name}" for name in self.element.types if name not in self.asked | same]


def ply_parts(data: bytes, who: str, name: str, files: MtlFiles, report: list[str]) -> list[MeshPart]:
    """The parts of a .ply file: one for each of its textures."""
    elements, textures = read_ply(data, who)
    vertex, face = (_Fields(kind, elements.pop(kind, Element(0))) for kind in ("vertex", "face"))
    if "packed_position" in vertex.element.types:
        raise SolariError(
            f"{who}: has compressed Gaussian splats, which aren't read: convert it to an uncompressed .ply"
        )
    part = MeshPart(name, vertex.columns(("x", "y", "z")), np.zeros((0, 3), np.int64))
    if part.positions is None:
        raise SolariError(f"{who}: has no vertices with x, y and z: give a file with a surface")
    part.normals = vertex.columns(_NORMAL)
    part.colors = vertex.columns(*_COLORS)
    part.uvs = vertex.columns(*_UVS)
    number = _add_faces(part, face, who)
    if not len(part.triangles) and (face.element.count or elements.get("tristrips", Element(0)).count):
        raise SolariError(
            f"{who}: has faces that can't be read: export it with lists of at least three vertices, 'vertex_indices'"
        )
    unread = [f"{kind} (all)" for kind, element in elements.items() if element.count]
    ignored = [*vertex.ignored(), *face.ignored(), *unread]
    if ignored:
        report.append(f"properties that are ignored: {', '.join(ignored)}")
    if textures and part.uvs is None:
        report.append(f"textures are left out, since there are no uvs for them: {', '.join(textures)}")
    return _textured(part, number, textures, files, report) if textures and part.uvs is not None else [part]


def _textured(
    part: MeshPart, number: NDArray[Any] | None, textures: list[str], files: MtlFiles, report: list[str]
) -> list[MeshPart]:
    """A part for each texture. number: of each triangle's texture; None if there is one for all."""
    if part.colors is not None:
        report.append("colors beside textures are ignored")
        part.colors = None
    if number is None:
        number = np.zeros(len(part.triangles))
        if textures[1:]:
            names = ", ".join(textures[1:])
            report.append(f"textures are left out, since no 'texnumber' says which faces have them: {names}")
    parts = []
    for texture, file in enumerate(textures):
        triangles = part.triangles[number == texture]
        if len(triangles):
            image = files.image(file)
            fields: dict[str, Any] = {} if image is None else {"base_color": 1.0, "base_color_texture": image}
            material = Material(name=file, double_sided=True, perceptual_roughness=1.0, **fields)
            parts.append(MeshPart(file, part.positions, triangles, part.normals, None, part.uvs, material))
    has_none = ~np.isin(number, np.arange(len(textures)))
    if has_none.any():
        report.append(f"faces whose 'texnumber' is that of no texture are gray: {has_none.sum():,} triangles")
        parts.append(MeshPart(part.name, part.positions, part.triangles[has_none], part.normals))
    return parts or [part]


def _add_faces(part: MeshPart, face: _Fields, who: str) -> NDArray[Any] | None:
    """Give a part its triangles, and vertices of their own to the corners of faces that have uvs or colors. Returns the
    number of each triangle's texture, if the file says it."""
    outlines = face.lists(*_VERTEX_LISTS)
    if outlines is None:
        # Some programs have a name of their own for the only list that can be meant.
        whole = [name for name, (length, kind) in face.element.types.items() if length and kind[0] in "iu"]
        outlines = face.lists(*whole) if len(whole) == 1 else None
    uvs = face.lists("texcoord")
    colors = face.columns(*_COLORS)
    texture = face.columns(("texnumber",))
    if outlines is None:
        return None
    corners = _checked(outlines.values, len(part.positions), f"{who}: '{part.name}'")
    triangles = triangulate(part.positions[corners], outlines.counts, who)
    face_of = np.repeat(np.arange(len(outlines.counts)), outlines.counts)
    if uvs is not None and not np.array_equal(uvs.counts, 2 * outlines.counts):
        uvs = None
    if uvs is None and colors is None:
        part.triangles = corners[triangles]
    else:
        part.triangles = triangles
        part.spread(corners)
    if uvs is not None:
        part.uvs = uvs.values.reshape(-1, 2)
    if colors is not None:
        part.colors = colors[face_of]
    return None if texture is None else texture[face_of[triangles[:, 0]], 0]
