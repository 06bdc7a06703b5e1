"""Meshes from OBJ, PLY and STL files, by the library trimesh."""

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
from solari_vk.scene.files.formats import reads
from solari_vk.scene.files.libraries import library, warn_of_missing
from solari_vk.scene.files.mtl import MtlFiles
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.matrices import rotation
from solari_vk.scene.matrices import unit as normalized
from solari_vk.scene.meshes.smoothing import smooth_normals
from solari_vk.scene.model import Instance, Material, Mesh, Scene

UP_AXES = {".obj": "y", ".ply": "y", ".stl": "z"}
"""The formats, and the axis that points up in most of their files. No format says so."""

_BYTES_PER_BYTE = 12  # of a file, while it is read
_BYTES_PER_PART = 2**15
_USED_MATERIAL = re.compile(rb"(?m)^usemtl[ \t]+([^\r\n]+)")
_PARTS = {".obj": re.compile(rb"(?m)^(?:o|g|usemtl)\b"), ".stl": re.compile(rb"endsolid")}
_BYTES_PER_TRIANGLE, _WORKING_BYTES = 150, 900  # of a triangle, and while its normals are made
_MOST_ELEMENTS, _MOST_PROPERTIES = 16, 256
_PLY_HEADER = re.compile(rb"\Aply.{,100000}?^end_header\r?\n", re.DOTALL | re.MULTILINE)
_PLY_LINE = re.compile(rb"(?m)^(?:element[ \t]+\S+[ \t]+(\d{1,18})|property[ \t])")
_BYTES_PER_LINE, _BYTES_PER_VALUE = 250, 250  # of text, as arrays of numpy


@reads(*UP_AXES, options=("up", "unit"), only=f"{', '.join(UP_AXES)} files need the axis that points up and the unit")
def load_mesh_file(
    path: str | os.PathLike[str], *, up: str | None = None, unit: float = 1.0, strict: bool = False
) -> Scene:
    """Load an .obj file with its materials, or a .ply or .stl file.

    up: the file's axis that points up, "x", "y" or "z"; by default "y", and "z" for .stl. unit: the file's unit
    in meters. Meshes without normals get smooth ones, with edges sharper than 40 degrees. Raises SolariError for a
    damaged file, and with `strict` for a missing material or image.
    """
    path = Path(path)
    if not 1e-12 <= unit <= 1e12:
        raise SolariError(f"{path}: the unit must be from 1e-12 to 1e12 meters, not {unit}")
    if up not in (None, "x", "y", "z"):
        raise SolariError(f"{path}: up: the axis that points up is 'x', 'y' or 'z', not {quoted(up)}")
    turn = _upright(up or UP_AXES[path.suffix.lower()]) * unit
    scene = Scene(name=path.stem)
    files = MtlFiles(path.parent)
    reader = library("trimesh.exchange.load", str(path)).mesh_loaders[path.suffix[1:].lower()]
    data = read_regular(path, str(path))
    _charge_file(path, data)
    read = _parse(reader, path, data, files)
    for name, part in read.get("geometry", {path.stem: read}).items():
        material = getattr(getattr(part.get("visual"), "material", None), "name", None)
        _add(scene, path, str(name), part, files.material(str(material)), turn)
    if strict and files.failures:
        raise SolariError(f"{path}: {files.failures[0]}")
    is_obj = path.suffix.lower() == ".obj"
    _report_materials(scene, files, _USED_MATERIAL.findall(data) if is_obj else [])
    if not scene.instances:
        reason = scene.warnings[-1] if scene.warnings else "has no triangles"
        raise SolariError(f"{path}: {reason}: give a file with a surface")
    return scene


def _charge_file(path: Path, data: bytes) -> None:
    """Charge what trimesh takes for a file, before it does."""
    charge(_BYTES_PER_BYTE * len(data), str(path), "its meshes")
    pattern = _PARTS.get(path.suffix.lower())
    if pattern is None:
        _check_ply(data, str(path))
    else:
        parts = sum(1 for _ in pattern.finditer(data))
        charge(_BYTES_PER_PART * parts, str(path), f"its {parts:,} parts")


def _parse(reader: Any, path: Path, data: bytes, files: MtlFiles) -> dict[str, Any]:
    """What trimesh reads: the arrays of a mesh, or of several under "geometry". reader: for the kind of file."""

    def silence(_: object) -> bool:
        return False

    kind = path.suffix[1:].lower()
    log = library("trimesh.util", str(path)).log
    log.addFilter(silence)  # it would print the tracebacks of what it recovers from
    try:
        # Of a .ply file's materials there are only images, which hold no more than the colors of its vertices.
        with warnings.catch_warnings(action="ignore"):  # of numpy, about numbers that are refused later
            read: dict[str, Any] = reader(
                io.BytesIO(data), file_type=kind, resolver=files, skip_materials=kind == "ply"
            )
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


def _add(
    scene: Scene, path: Path, name: str, part: dict[str, Any], material: Material | None, turn: NDArray[np.float64]
) -> None:
    """Add a part of the file to the scene."""
    positions = _rows(part.get("vertices"), 3)
    triangles = library("trimesh.geometry", str(path)).triangulate_quads(part.get("faces", ()))
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.size(part.get("vertices", ())):
        scene.warnings.append(f"parts without triangles are left out: '{name}'")
        return
    if positions is None:
        scene.warnings.append(f"parts with vertices that aren't finite are left out: '{name}'")
        return
    if triangles.min() < 0 or triangles.max() >= len(positions):
        raise SolariError(f"{path}: '{name}' has triangles of vertices that don't exist: export the file again")
    # Before the normals are made, whose arrays are the largest.
    working = _WORKING_BYTES * len(triangles)
    charge(_BYTES_PER_TRIANGLE * len(triangles), f"{path}: '{name}'", f"{len(triangles):,} triangles", working=working)
    positions = positions @ turn.T
    if not np.abs(positions).max() <= checks.LARGEST_COORDINATE:
        raise SolariError(
            f"{path}: '{name}' has coordinates that aren't finite, or above {checks.LARGEST_COORDINATE:g} meters: "
            "export the file again, or give its unit"
        )
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    # Triangles without area have no normal.
    triangles = triangles[np.cross(b - a, c - a).any(axis=1)]
    if not len(triangles):
        scene.warnings.append(f"parts whose triangles have no area are left out: '{name}'")
        return
    if part.get("face_colors") is not None:
        scene.warnings.append(f"colors of faces are ignored: '{name}'")
    mesh = _mesh(name, part, positions, triangles, turn)
    scene.add(Instance(mesh, material if material is not None else _plain(mesh.colors is not None), name=name))


def _mesh(
    name: str, part: dict[str, Any], positions: NDArray[np.float64], triangles: NDArray[Any], turn: NDArray[np.float64]
) -> Mesh:
    """The mesh of a part, with the file's normals or smooth ones."""
    colors = _colors(part.get("vertex_colors"), len(positions))
    uvs: Any = _rows(getattr(part.get("visual"), "uv", None), 2, len(positions))
    normals: Any = _rows(part.get("vertex_normals"), 3, len(positions))
    if normals is None:
        # Sharp edges split vertices, so that all else is needed for the split ones.
        source, normals, triangles = smooth_normals(positions, triangles)
        positions = positions[source]
        colors = None if colors is None else colors[source]
        uvs = None if uvs is None else uvs[source]
    else:
        normals = normalized(normals @ turn.T)
        normals[~normals.any(axis=1)] = (0, 1, 0)
    if uvs is not None:
        uvs = np.array([0, 1]) + np.array([1, -1]) * uvs  # v increases upwards in these files, downwards in glTF
    return Mesh(
        positions.astype(np.float32), triangles.astype(np.uint32), normals=normals, uvs=uvs, colors=colors, name=name
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


def _check_ply(data: bytes, who: str) -> None:
    """Charge what reading a .ply file takes. Raises SolariError for a header that says more than the file can have: the
    reader of trimesh would believe it, and take memory and time for it."""
    # The counts of the header, which the reader would allocate for, must fit into the file.
    header = _PLY_HEADER.match(data)
    if header is None:
        raise SolariError(f"{who}: its header is missing or too long: export it again")
    counts, properties = _ply_elements(header[0])
    if len(counts) > _MOST_ELEMENTS or sum(properties) > _MOST_PROPERTIES:
        raise SolariError(
            f"{who}: has {len(counts)} elements and {sum(properties)} properties; at most "
            f"{_MOST_ELEMENTS} and {_MOST_PROPERTIES} are read: leave out what isn't needed"
        )
    values = sum(count * max(width, 1) for count, width in zip(counts, properties, strict=True))
    if values > len(data):
        raise SolariError(f"{who}: says that it has {values:,} values, but has {len(data):,} bytes: export it again")
    if b"ascii" in header[0][:100]:
        _charge_ply_lines(data[header.end() :].split(b"\n"), counts, properties, who)


def _ply_elements(header: bytes) -> tuple[list[int], list[int]]:
    """For each kind of element, such as vertices and faces, how many the file has, and their number of properties."""
    counts: list[int] = []
    properties: list[int] = []
    for line in _PLY_LINE.finditer(header):
        if line[1]:
            counts.append(int(line[1]))
            properties.append(0)
        elif properties:
            properties[-1] += 1
    return counts, properties


def _charge_ply_lines(lines: list[bytes], counts: list[int], properties: list[int], who: str) -> None:
    """Charge the lines of a text file. Elements whose lines differ in length, such as faces of triangles and quads,
    trimesh makes an array each."""
    start = 0
    uneven = 0
    for count, width in zip(counts, properties, strict=True):
        if len({len(line.split()) for line in lines[start : start + count]}) > 1:
            uneven += count * width
        start += count
    charge(_BYTES_PER_LINE * len(lines) + _BYTES_PER_VALUE * uneven, who, "its lines")
