"""Polygons and simple shapes of a stage as triangles, with the primvars that materials ask for."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError
from solari_vk.scene import checks, shapes
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.matrices import rotation
from solari_vk.scene.meshes.polygons import triangulate
from solari_vk.scene.meshes.smoothing import area_vectors, fitted_normals
from solari_vk.scene.meshes.tangents import weld
from solari_vk.scene.model import Mesh

Integers = NDArray[np.int64]
_BYTES_PER_CORNER = 120
_SEGMENTS = 64
_AXES = {"Y": np.eye(3), "X": rotation((0, 0, 1), -math.pi / 2), "Z": rotation((1, 0, 0), math.pi / 2)}
_CAGE = "subdivision surfaces are shown as their control cage, with smooth normals"
_CREASES = "creases and corners of subdivision surfaces are shown smooth"
_WRONG_PRIMVAR = "primvars with wrong numbers of values are left out"
_FIRST = "simple shapes take the first of several values of a primvar"
DISPLAY, DISPLAY_OPACITY = "displayColor", "displayOpacity"
VARIES = "varies"
"""In place of the value of a primvar that has several."""


@dataclass
class Values:
    """A primvar: rows of values, and which row the points, faces or corners have."""

    rows: NDArray[Any]
    index: Integers
    interpolation: str

    @cached_property
    def constant(self) -> Any:
        """The value as a tuple, VARIES where there are several."""
        used = self.index[:1] if self.interpolation == "constant" else np.unique(self.index)
        return tuple(self.rows[used[0]].tolist()) if len(used) == 1 else VARIES


class Surface:
    """The triangles of a prim. `parts`: the name of each subset, "" for the rest, and its triangles (M,)."""

    def __init__(self, prim: Any, motion_time: Any, report: Report, who: str) -> None:
        self.prim = prim
        self._time = motion_time
        self._report = report
        self.place = f"<{prim.GetPath()}>"
        self._who = f"{who}: {self.place}"
        mesh = UsdGeom.Mesh(prim)
        self.points = self._array(UsdGeom.PointBased(prim).GetPointsAttr(), 3)
        if prim.IsA(UsdGeom.TetMesh):
            faces = np.array(UsdGeom.TetMesh.ComputeSurfaceFaces(UsdGeom.TetMesh(prim), motion_time), np.int64)
            self.indices = faces.reshape(-1)
            counts = np.full(len(self.indices) // 3, 3)
        else:
            counts = self._integers(mesh.GetFaceVertexCountsAttr())
            self.indices = self._integers(mesh.GetFaceVertexIndicesAttr())
        self._check(counts)
        charge(_BYTES_PER_CORNER * len(self.indices), self._who, f"{len(self.indices):,} corners of polygons")
        self.triangles = triangulate(self.points[self.indices], counts, self._who)
        self.face_of = np.repeat(np.arange(len(counts)), counts)
        self.face_count = len(counts)
        holes = self._integers(mesh.GetHoleIndicesAttr()) if mesh else ()
        self.triangles = self.triangles[~np.isin(self.face_of[self.triangles[:, 0]], holes)]
        if UsdGeom.Gprim(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            self.triangles = self.triangles[:, ::-1]
        self.triangles = self.triangles[area_vectors(*self.shape()).any(axis=1)]
        if not len(self.indices):
            report.add("meshes without faces show nothing", self.place)
        elif not len(self.triangles):
            raise self._error("has no triangle with an area: export it again, or remove it")
        self._smooth: NDArray[Any] | None = None
        self._scheme = mesh.GetSubdivisionSchemeAttr().Get(self._time) if mesh else UsdGeom.Tokens.none
        if len(self.triangles) and self._scheme != UsdGeom.Tokens.none:
            self._add_cage(mesh)
        self.parts = self._parts(mesh)
        self._primvars: dict[Any, Values | None] = {}

    def shape(self) -> tuple[NDArray[np.float64], Integers]:
        """The points (N, 3), and those of all triangles (M, 3)."""
        return self.points, self.indices[self.triangles]

    def at(self, prim: Any) -> Surface:
        """The same with what another instance inherits."""
        other = copy.copy(self)
        other.prim = prim
        other.place = f"<{prim.GetPath()}>"
        return other

    def _add_cage(self, mesh: Any) -> None:
        """The normals of a subdivision surface."""
        if self._scheme == UsdGeom.Tokens.bilinear:
            return  # it is as flat as its cage
        self._report.add(_CAGE, self.place)
        if len(self._integers(mesh.GetCreaseIndicesAttr())) or len(self._integers(mesh.GetCornerIndicesAttr())):
            self._report.add(_CREASES, self.place)
        # Over all parts, so that no seam shows between two.
        points, every = self.shape()
        self._smooth = fitted_normals(np.zeros_like(points), every, area_vectors(points, every))[0]

    def _error(self, text: str) -> SolariError:
        return SolariError(f"{self._who} {text}")

    def _array(self, attribute: Any, width: int) -> NDArray[np.float64]:
        found = attribute.Get(self._time)
        values = np.zeros((0, width)) if found is None else np.array(found, np.float64).reshape(-1, width)
        if not np.abs(values).max(initial=0) <= checks.LARGEST_COORDINATE:
            raise self._error(f"has {attribute.GetName()} that aren't finite or too large: export the file again")
        return values

    def _integers(self, attribute: Any) -> Integers:
        found = attribute.Get(self._time)
        return np.zeros(0, np.int64) if found is None else np.array(found, np.int64)

    def _check(self, counts: Integers) -> None:
        if (counts < 0).any() or counts.sum() != len(self.indices):
            raise self._error(
                f"has faces of {counts.sum():,} corners, but {len(self.indices):,} indices: export it again"
            )
        if len(self.indices) and not 0 <= self.indices.min() <= self.indices.max() < len(self.points):
            raise self._error("has faces of points that don't exist: export it again")

    def _parts(self, mesh: Any) -> list[tuple[str, NDArray[np.bool_]]]:
        """Triangles by the subsets for materials."""
        face = self.face_of[self.triangles[:, 0]]
        rest = np.ones(len(face), bool)
        found = []
        for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh) if mesh else ():
            family = subset.GetFamilyNameAttr().Get()
            if family != "materialBind" or subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            own = np.isin(face, self._integers(subset.GetIndicesAttr())) & rest
            rest &= ~own
            found.append((subset.GetPrim().GetName(), own))
        found.append(("", rest))
        return [part for part in found if part[1].any()]

    # ---- primvars -----------------------------------------------------------------------------------

    def primvar(self, name: str) -> Values | None:
        """A primvar by its name; None for one that isn't there, and (reported) for a wrong one."""
        primvar, source = self._find(name)
        key = name, source
        if key not in self._primvars:
            self._primvars[key] = None
            if primvar and primvar.HasValue():
                indices = primvar.GetIndices(self._time)
                self._primvars[key] = self._values(primvar.GetAttr(), indices, str(primvar.GetInterpolation()))
        return self._primvars[key]

    def _find(self, name: str) -> tuple[Any, str]:
        """A primvar, and its path if an instance inherits it from outside of its prototype, else ""."""
        primvar = UsdGeom.PrimvarsAPI(self.prim).FindPrimvarWithInheritance(name)
        if not primvar or not self.prim.IsInstanceProxy():
            return primvar, ""
        owner = primvar.GetAttr().GetPrim()
        # Instances nest: the owner may be in the prototype of an outer one.
        prototype = self.prim.GetPrimInPrototype().GetPrototype()
        is_shared = owner.IsInstanceProxy() and owner.GetPrimInPrototype().GetPrototype() == prototype
        return primvar, "" if is_shared else str(primvar.GetAttr().GetPath())

    def sources(self, names: Iterable[str]) -> tuple[str, ...]:
        """What tells the values of primvars from those of other instances."""
        return tuple(self._find(name)[1] for name in names if name)

    def constant(self, name: str) -> Any:
        """The value of a primvar as a tuple, None without one, and VARIES where it has several."""
        values = self.primvar(name)
        return None if values is None else values.constant

    def _values(self, attribute: Any, indices: Any, interpolation: str) -> Values | None:
        place = f"{self.place} {attribute.GetName()}"
        rows = finite_rows(attribute.Get(self._time), attribute, place, self._report)
        if rows is None:
            return None
        index = np.arange(len(rows)) if indices is None or not len(indices) else np.array(indices, np.int64)
        counts = {"constant": 1, "uniform": self.face_count, "faceVarying": len(self.indices)}
        wanted = counts.get(interpolation, len(self.points))
        if (interpolation != "constant" and len(index) != wanted) or not 0 <= index.min() <= index.max() < len(rows):
            self._report.add(_WRONG_PRIMVAR, place)
            return None
        if interpolation == "faceVarying" and (indices is None or not len(indices)):
            return _welded(rows)
        return Values(rows, index, interpolation)

    def _normals(self) -> Values | None:
        """The normals of the file, or those that its scheme asks for; None for those of the triangles."""
        if self._smooth is not None:
            return Values(self._smooth, np.arange(len(self._smooth)), "vertex")
        if self._scheme != UsdGeom.Tokens.none:
            return None
        mesh = UsdGeom.PointBased(self.prim)
        found = self.primvar("normals")  # which has precedence
        attribute = mesh.GetNormalsAttr()
        if found is None and attribute.HasAuthoredValue():
            found = self._values(attribute, None, str(mesh.GetNormalsInterpolation()))
        return found if found is not None and found.rows.shape[1] == 3 else None

    def _index(self, values: Values, corners: Integers) -> Integers:
        """The rows of corners (K,)."""
        kind = values.interpolation
        if kind == "constant":
            return np.full(len(corners), int(values.index[0]), np.int64)
        place = {"uniform": self.face_of, "faceVarying": np.arange(len(self.indices))}.get(kind, self.indices)
        found: Integers = values.index[place[corners]]
        return found

    def mesh(
        self, chosen: NDArray[np.bool_], uv_names: tuple[str, ...], color: str, opacity: str, name: str
    ) -> tuple[Mesh, Integers]:
        """The Mesh of some of the triangles, and the point (N,) of each of its vertices. uv_names: the sets of uvs.
        color, opacity: the primvars of vertices, "" for none."""
        flat = self.triangles[chosen].ravel()
        columns = {"normals": self._normals()}
        columns |= {f"uv {number}": self.primvar(uvs) for number, uvs in enumerate(uv_names)}
        columns |= {"color": self.primvar(color) if color else None}
        columns |= {"opacity": self.primvar(opacity) if opacity else None}
        key = self.indices[flat]
        rows = {name: self._index(values, flat) for name, values in columns.items() if values is not None}
        for name_of, index in rows.items():
            values = columns[name_of]
            if values is not None and values.interpolation in ("uniform", "faceVarying"):
                # Vertices are split where a value differs.
                key = np.unique(key, return_inverse=True)[1].reshape(-1) * (int(index.max()) + 1) + index
        _, first, triangles = np.unique(key, return_index=True, return_inverse=True)
        made = {name: columns[name].rows[index[first]] for name, index in rows.items()}  # type: ignore[union-attr]
        points = self.indices[flat][first]
        fields = self._fields(made, len(uv_names))
        if "normals" in made:
            faces = triangles.reshape(-1, 3)
            fields["normals"] = fitted_normals(made["normals"], faces, area_vectors(self.points[points], faces))[0]
        shape = Mesh(
            self.points[points].astype(np.float32), triangles.reshape(-1, 3).astype(np.uint32), name=name, **fields
        )
        return shape, points

    def _fields(self, made: dict[str, NDArray[Any]], uv_count: int) -> dict[str, Any]:
        """The uvs and colors of a Mesh."""
        sets: list[Any] = []
        for number in range(uv_count):
            uv = made.get(f"uv {number}")
            # v increases upwards in USD.
            usable = uv is not None and uv.shape[1] >= 2 and np.abs(uv).max() < 1e9
            sets.append(np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32) if usable else None)  # type: ignore[index]
        spare = next((uv for uv in sets if uv is not None), None)
        fields: dict[str, Any] = {}
        if spare is not None:
            sets = [spare if uv is None else uv for uv in sets]
            fields["uvs"] = sets[0]
            if len(sets) > 1:
                fields["second_uvs"] = sets[1]
            if len(sets) > 2:
                fields["more_uvs"] = np.stack(sets[2:])
        color, alpha = made.get("color"), made.get("opacity")
        if color is not None and color.shape[1] < 3:
            color = np.repeat(color[:, :1], 3, axis=1)
        if color is None and alpha is not None:
            color = np.ones((len(alpha), 3))
        if color is not None:
            shown = color[:, :3] if alpha is None else np.hstack([color[:, :3], alpha[:, :1]])
            fields["colors"] = shown.clip(0, 1).astype(np.float32)
        return fields


def finite_rows(found: Any, attribute: Any, place: str, report: Report) -> NDArray[np.float64] | None:
    """The values (N, K) of a primvar's attribute, one row for one that is no array; None without any, and (reported)
    for those that aren't finite numbers."""
    if found is None:
        return None
    rows = np.array(found if attribute.GetTypeName().isArray else [found])
    if rows.dtype.kind not in "fiu" or not np.isfinite(rows).all():
        report.add("primvars that aren't finite numbers are left out", place)
        return None
    return rows.astype(np.float64).reshape(len(rows), -1) if rows.size else None


def shape_constant(prim: Any, name: str, time: Any, report: Report) -> tuple[float, ...] | None:
    """The value of a primvar of a simple shape, None without one."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar:
        return None
    rows = finite_rows(primvar.ComputeFlattened(time), primvar.GetAttr(), f"<{prim.GetPath()}> {name}", report)
    if rows is None:
        return None
    if len(rows) > 1 and primvar.GetInterpolation() != "constant":
        report.add(_FIRST, f"<{prim.GetPath()}> {name}")
    return tuple(rows[0].tolist())


_SIZES: dict[str, dict[str, float]] = {
    "Cube": {"size": 2},
    "Sphere": {"radius": 1},
    "Cylinder": {"radius": 1, "height": 2},
    "Cylinder_1": {"radiusTop": 1, "radiusBottom": 1, "height": 2},
    "Cone": {"radius": 1, "height": 2},
    "Capsule": {"radius": 0.5, "height": 1},
    "Capsule_1": {"radiusTop": 0.5, "radiusBottom": 0.5, "height": 1},
    "Plane": {"width": 2, "length": 2},
}
Simple = tuple[str, str, tuple[float, ...]]
"""The type of a simple shape, its axis and its sizes."""


def simple_shape(prim: Any, time: Any) -> Simple | None:
    """What a Cube, Sphere, Cylinder, Cone, Capsule or Plane is; None for another prim."""
    kind = str(prim.GetTypeName())
    if kind not in _SIZES:
        return None
    sizes = []
    for name, default in _SIZES[kind].items():
        found = prim.GetAttribute(name).Get(time)
        sizes.append(default if found is None else float(found))
        is_flat = sizes[-1] == 0 and name in ("size", "radius", "width", "length")
        if is_flat or not 0 <= sizes[-1] <= checks.LARGEST_COORDINATE:
            raise SolariError(f"<{prim.GetPath()}> has the {name} {sizes[-1]:g}: give it a finite one above 0")
    axis = str(prim.GetAttribute("axis").Get(time) or "Z") if prim.HasAttribute("axis") else "Y"
    return kind, axis, tuple(sizes)


def shape_mesh(shape: Simple) -> Mesh:
    """The mesh of a simple shape."""
    kind, axis, sizes = shape
    if kind == "Plane":
        return _plane(sizes[0], sizes[1], axis)
    if kind == "Cube":
        mesh = shapes.box((-sizes[0] / 2,) * 3, (sizes[0] / 2,) * 3)
    elif kind == "Sphere":
        mesh = shapes.sphere(sizes[0], _SEGMENTS)
    else:
        mesh = _turned_shape(kind, sizes)
    turn = _AXES[axis].astype(np.float32)
    normals = None if mesh.normals is None else mesh.normals @ turn.T
    return Mesh(mesh.positions @ turn.T, mesh.triangles, normals=normals, uvs=mesh.uvs, name=kind)


def _welded(rows: NDArray[np.float64]) -> Values:
    """Values of corners (N, K), of which equal ones share a row."""
    index = weld(rows)
    _, first = np.unique(index, return_index=True)
    return Values(rows[first], index, "faceVarying")


def _turned_shape(kind: str, sizes: tuple[float, ...]) -> Mesh:
    """A shape about the y axis."""
    radius, height = sizes[0], sizes[-1]
    if kind == "Cone":
        return shapes.cone(radius, height, _SEGMENTS)
    is_capsule = kind.startswith("Capsule")
    if len(sizes) == 2 or sizes[0] == sizes[1]:
        make = shapes.capsule if is_capsule else shapes.cylinder
        return make(radius, height, _SEGMENTS)
    top, bottom = sizes[:2]
    # The wall's normal points up by this angle. Caps are parts of spheres that touch the wall.
    tilt = math.atan2(bottom - top, height)
    side = (math.cos(tilt), math.sin(tilt))
    if not is_capsule:
        points = [(0, height / 2), (top, height / 2), (top, height / 2)]
        points += [(bottom, -height / 2), (bottom, -height / 2), (0, -height / 2)]
        return shapes.revolved(points, [(0, 1), (0, 1), side, side, (0, -1), (0, -1)], _SEGMENTS, kind)
    profile, normals = [], []
    for end, radius, place in ((math.pi / 2, top, height / 2), (-math.pi / 2, bottom, -height / 2)):
        turn = np.linspace(end, tilt, _SEGMENTS // 4 + 1)[:: 1 if end > 0 else -1]
        outward = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        outward[np.abs(turn) == math.pi / 2, 0] = 0
        profile.append(outward * radius / math.cos(tilt) + (0, place - radius * math.tan(tilt)))
        normals.append(outward)
    return shapes.revolved(np.concatenate(profile), np.concatenate(normals), _SEGMENTS, kind)


def _plane(width: float, length: float, axis: str) -> Mesh:
    """A rectangle that faces an axis, with its width along x (facing x, z) and its length along y (facing y, z)."""
    across, along = {"X": ((0, 0, 1), (0, 1, 0)), "Y": ((1, 0, 0), (0, 0, 1)), "Z": ((1, 0, 0), (0, 1, 0))}[axis]
    u, v = np.array(across) * width / 2, np.array(along) * length / 2
    corners = np.array([-u - v, u - v, u + v, -u + v])
    facing = np.cross(u, v) @ np.abs(np.cross(across, along)) > 0
    triangles = np.array([(0, 1, 2), (0, 2, 3)])[:, :: 1 if facing else -1]
    uvs = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float32)
    return Mesh(corners, triangles, uvs=uvs, name="plane")
