"""Meshes from OBJ and STL files, by the library trimesh, and from PLY files."""

from __future__ import annotations

import io
import math
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.files import read_regular
from solari_vk.scene import checks
from solari_vk.scene.bounds import origin_near
from solari_vk.scene.files.formats import reads
from solari_vk.scene.files.gltf.points_and_lines import DRAWN_POINTS, with_surface
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.files.libraries import library, warn_of_missing
from solari_vk.scene.files.mesh_parts import MeshPart, ply_parts, stl_colors, triangulated_obj
from solari_vk.scene.files.mtl import MtlFiles
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.matrices import rotation
from solari_vk.scene.matrices import unit as normalized
from solari_vk.scene.meshes.smoothing import smooth_normals
from solari_vk.scene.meshes.tangents import weld
from solari_vk.scene.model import Instance, Material, Mesh, Scene

UP_AXES = {".obj": "y", ".ply": "y", ".stl": "z"}
"""The formats, and the axis that points up in most of their files. No format says so."""

_BYTES_PER_BYTE = 12  # of a file, while it is read
_BYTES_PER_PART = 2**15
_POINT_OR_LINE, _LINE = re.compile(rb"\n[pl][ \t]"), re.compile(rb"\nl[ \t]")
_USED_MATERIAL = re.compile(rb"(?m)^usemtl[ \t]+([^\r\n]+)")
_PARTS = {".obj": re.compile(rb"(?m)^(?:o|g|usemtl)\b"), ".stl": re.compile(rb"endsolid"), ".ply": None}
_BYTES_PER_TRIANGLE, _WORKING_BYTES = 150, 900  # of a triangle, and while its normals are made
_BLANKS_AND_COMMENTS = re.compile(rb"\n(?:[ \t]+(?:#[^\n]*)?|#[^\n]*)")
_CONTINUED = re.compile(rb"\\[ \t]*(?:\n|\Z)")
_COMMENT_BEHIND_NUMBERS = re.compile(rb"(\n[vflp][^\n#]*)#[^\n]*")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_STL_HEAD, _STL_TRIANGLE = 84, 50  # bytes


@reads(
    *UP_AXES,
    options=("up", "unit"),
    only=f"{', '.join(UP_AXES)} files need the axis that points up and the unit: "
    "glTF, USD and robots' files are turned to y up already",
)
def load_mesh_file(
    path: str | os.PathLike[str], *, up: str | None = None, unit: float = 1.0, strict: bool = False
) -> Scene:
    """Load an .obj file with its materials, or a .ply or .stl file.

    up: the file's axis that points up, "x", "y" or "z"; by default "y", and "z" for .stl. unit: the file's unit
    in meters. Meshes without normals get smooth ones, with edges sharper than 40 degrees. Raises SolariError for a
    damaged file, and with `strict` for a missing material or image. A file of points alone is drawn as small spheres.
    """
    path = Path(path)
    if not 1e-12 <= unit <= 1e12:
        raise SolariError(f"{path}: the unit must be from 1e-12 to 1e12 meters, not {unit}")
    if up not in (None, "x", "y", "z"):
        raise SolariError(f"{path}: up: the axis that points up is 'x', 'y' or 'z', not {quoted(up)}")
    turn = _upright(up or UP_AXES[path.suffix.lower()]) * unit
    scene = Scene(name=path.stem)
    files = MtlFiles(path.parent)
    kind = path.suffix.lower()
    reader = None if kind == ".ply" else library("trimesh.exchange.load", str(path)).mesh_loaders[kind[1:]]
    data = _cleaned(read_regular(path, str(path)), kind)
    _charge_file(path, data)
    for part in _parts(path, reader, data, files, scene.warnings):
        _add(scene, path, part, turn)
    if strict and files.failures:
        raise SolariError(f"{path}: {files.failures[0]}")
    _report_materials(scene, files, _USED_MATERIAL.findall(data) if kind == ".obj" else [])
    if not scene.instances:
        reason = scene.warnings[-1] if scene.warnings else "has no triangles"
        raise SolariError(f"{path}: {reason}: give a file with a surface")
    return scene


def _charge_file(path: Path, data: bytes) -> None:
    """Charge what trimesh takes for a file, before it does."""
    charge(_BYTES_PER_BYTE * len(data), str(path), "its meshes")
    pattern = _PARTS[path.suffix.lower()]
    if pattern is not None:
        parts = sum(1 for _ in pattern.finditer(data))
        charge(_BYTES_PER_PART * parts, str(path), f"its {parts:,} parts")


def _cleaned(data: bytes, kind: str) -> bytes:
    """A file without what readers needn't know: a byte order mark, line ends other than LF, comments and continued
    lines of .obj, and bytes behind the last triangle of binary STL, whose number its header has."""
    if kind == ".ply":
        return data.removeprefix(_BYTE_ORDER_MARK)
    triangles = int.from_bytes(data[_STL_HEAD - 4 : _STL_HEAD], "little")
    end = _STL_HEAD + _STL_TRIANGLE * triangles
    if kind == ".stl" and triangles > 0 and end <= len(data):
        return data[:end]
    data = data.removeprefix(_BYTE_ORDER_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if kind == ".obj":
        # Comments go first: a folder's name at the end of one may end with a backslash, which continues no line.
        data = _BLANKS_AND_COMMENTS.sub(b"\n", b"\n" + data)
        data = _CONTINUED.sub(b" ", data)
        if b"#" in data:
            data = _COMMENT_BEHIND_NUMBERS.sub(rb"\1", data)
    return data


def _parts(path: Path, reader: Any, data: bytes, files: MtlFiles, warnings: list[str]) -> list[MeshPart]:
    """What a file has, without regard to its axes. reader: of trimesh."""
    who = str(path)
    kind = path.suffix.lower()
    if kind == ".ply":
        return ply_parts(data, who, path.stem, files, warnings)
    read = _parse(reader, path, triangulated_obj(data, who) if kind == ".obj" else data, files)
    found = []
    for name, part in read.get("geometry", {path.stem: read}).items():
        visual = part.get("visual")
        material = getattr(getattr(visual, "material", None), "name", None)
        colors = stl_colors(part, data) if kind == ".stl" else part.get("vertex_colors")
        arrays = {"normals": part.get("vertex_normals"), "colors": colors, "uvs": getattr(visual, "uv", None)}
        faces = np.asarray(part.get("faces", ()), np.int64)
        if faces.shape[1:] == (4,):
            faces = faces[:, (0, 1, 2, 0, 2, 3)]  # `triangulated_obj` has left only those that this covers
        triangles = faces.reshape(-1, 3)
        made = MeshPart(str(name), part.get("vertices"), triangles, material=files.material(str(material)), **arrays)
        found.append(made)
    if kind == ".obj" and any(len(part.triangles) for part in found):
        if _POINT_OR_LINE.search(data):
            warnings.append("points and lines beside faces are left out")
    elif kind == ".obj" and b"\nf" in data:
        raise SolariError(f"{who}: has faces that can't be read: export it with at least three vertices for each")
    elif kind == ".obj" and _LINE.search(data):
        warnings.append("lines are left out, and only points are drawn")
    return found


def _parse(reader: Any, path: Path, data: bytes, files: MtlFiles) -> dict[str, Any]:
    """What trimesh reads: the arrays of a mesh, or of several under "geometry". reader: for the kind of file."""

    def silence(_: object) -> bool:
        return False

    kind = path.suffix[1:].lower()
    log = library("trimesh.util", str(path)).log
    log.addFilter(silence)  # it would print the tracebacks of what it recovers from
    try:
        with warnings.catch_warnings(action="ignore"):  # of numpy, about numbers that are refused later
            read: dict[str, Any] = reader(io.BytesIO(data), file_type=kind, resolver=files)
            return read
    except MemoryError:
        raise SolariError(f"{path}: too large for this machine's memory") from None
    except Exception as error:  # trimesh raises many types of exceptions for damaged files
        reason = (str(error) or type(error).__name__).splitlines()[0][:100]
        raise SolariError(f"{path}: a damaged {path.suffix} file ({reason}): export it again") from None
    finally:
        log.removeFilter(silence)


def _report_materials(scene: Scene, files: MtlFiles, used: list[bytes]) -> None:
    """Add what is missing of materials to the scene's warnings. used: the names of materials that the file has."""
    scene.warnings.extend(files.failures)
    warn_of_missing(files.failures)
    unknown = {" ".join(name.decode("utf-8", "replace").split()) for name in used} - files.fields.keys()
    if unknown:
        names = ", ".join(sorted(unknown))
        scene.warnings.append(f"materials that no .mtl file has are replaced by a gray one: {names}")
    if files.ignored:
        scene.warnings.append(f"fields and options of the .mtl file that are ignored: {', '.join(files.ignored)}")


def _add(scene: Scene, path: Path, part: MeshPart, turn: NDArray[np.float64]) -> None:
    """Add a part of the file to the scene."""
    name, triangles = part.name, part.triangles
    positions = _rows(part.positions, 3)
    if positions is None:
        scene.warnings.append(f"parts with vertices that aren't finite are left out: '{name}'")
        return
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(positions)):
        raise SolariError(f"{path}: '{name}' has triangles of vertices that don't exist: export the file again")
    # Before the normals are made, whose arrays are the largest.
    working = _WORKING_BYTES * len(triangles)
    charge(_BYTES_PER_TRIANGLE * len(triangles), f"{path}: '{name}'", f"{len(triangles):,} triangles", working=working)
    positions = positions @ turn.T
    if not np.abs(positions).max(initial=0) <= checks.LARGEST_COORDINATE:
        raise SolariError(
            f"{path}: '{name}' has coordinates that aren't finite, or above {checks.LARGEST_COORDINATE:g} meters: "
            "export the file again, or give its unit"
        )
    # Vertices have 32 bits, which maps and scans with coordinates of a country need around a place of their own.
    place = origin_near(positions) if len(positions) else np.zeros(3)
    positions = positions - place
    if not len(triangles) and len(positions):
        mesh = _points(scene, path, part, positions)
    else:
        a, b, c = (positions[triangles[:, corner]] for corner in range(3))
        # Triangles without area have no normal.
        triangles = triangles[np.cross(b - a, c - a).any(axis=1)]
        if not len(triangles):
            scene.warnings.append(f"parts whose triangles have no area are left out: '{name}'")
            return
        mesh = _mesh(part, positions, triangles, turn)
    material = part.material if part.material is not None else _plain(mesh.colors is not None)
    scene.add(Instance(mesh, material, place, name=name))


def _points(scene: Scene, path: Path, part: MeshPart, positions: NDArray[np.float64]) -> Mesh:
    """The spheres of points without faces."""
    vertices: dict[str, NDArray[Any]] = {"POSITION": positions.astype(np.float32)}
    colors = _colors(part.colors, len(positions))
    if colors is not None:
        vertices["COLOR"] = colors
    entry = Entry(str(path), f"'{part.name}'", {})
    found, triangles, step = with_surface(vertices, np.arange(len(positions), dtype=np.uint32), 0, entry)
    scene.warnings.append(f"{DRAWN_POINTS}: '{part.name}'")
    if step > 1:
        scene.warnings.append(f"only one of {step} points is drawn: '{part.name}'")
    return Mesh(found["POSITION"], triangles, normals=found["NORMAL"], colors=found.get("COLOR"), name=part.name)


def _mesh(part: MeshPart, positions: NDArray[np.float64], triangles: NDArray[Any], turn: NDArray[np.float64]) -> Mesh:
    """The mesh of a part, with the file's normals or smooth ones."""
    colors = _colors(part.colors, len(positions))
    uvs: Any = _rows(part.uvs, 2, len(positions))
    if uvs is not None and np.abs(uvs).max(initial=0) > np.finfo(np.float32).max:
        uvs = None
    normals: Any = _rows(part.normals, 3, len(positions))
    if normals is None:
        # Sharp edges split vertices, and so do edges of colors and uvs.
        given = [values for values in (colors, uvs) if values is not None]
        apart = weld(np.hstack(given)) if given else None
        source, normals, triangles = smooth_normals(positions, triangles, apart=apart)
        positions = positions[source]
        colors = None if colors is None else colors[source]
        uvs = None if uvs is None else uvs[source]
    else:
        normals = normalized(normals @ turn.T)
        normals[~normals.any(axis=1)] = (0, 1, 0)
    if uvs is not None:
        uvs = np.array([0, 1]) + np.array([1, -1]) * uvs  # v increases upwards in these files, downwards in glTF
    return Mesh(
        positions.astype(np.float32),
        triangles.astype(np.uint32),
        normals=normals,
        uvs=uvs,
        colors=colors,
        name=part.name,
    )


def _plain(colored: bool) -> Material:
    """The material of files without one: gray, or as the vertices' colors are."""
    return Material(base_color=np.full(3, 1.0 if colored else 0.6, np.float32), double_sided=True, name="default")


def _rows(values: Any, width: int, count: int | None = None) -> NDArray[np.float64] | None:
    """Finite numbers (count, width) from those that a file has for its vertices; None for what doesn't fit."""
    try:
        with np.errstate(invalid="ignore"):  # signaling NaN
            rows = np.asarray(values, np.float64)[:, :width]
    except (IndexError, TypeError, ValueError):
        return None
    fits = rows.shape == (len(rows) if count is None else count, width) and bool(np.isfinite(rows).all())
    return rows if fits else None


def _colors(values: Any, count: int) -> NDArray[np.float32] | None:
    """Linear colors (N, 3) of vertices from those of a file, which are sRGB."""
    colors = _rows(values, 3, count)
    if colors is None:
        return None
    # Integers are codes of 8 bits, floats are in [0, 1].
    codes = colors if np.asarray(values).dtype.kind in "iu" else 255 * colors
    linear: NDArray[np.float32] = LINEAR_OF_SRGB[np.rint(np.clip(codes, 0, 255)).astype(np.int64)]
    return linear


def _upright(up: str) -> NDArray[np.float64]:
    """The rotation (3, 3) that turns a file's axis upwards."""
    turns = {"y": np.eye(3), "z": rotation((1, 0, 0), -math.pi / 2), "x": rotation((0, 0, 1), math.pi / 2)}
    return turns[up]
