"""Mesh primitives of a glTF file: triangles, checked vertices, and tangents where a normal map needs them."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import BudgetError
from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.deform import Vertices, deformation_of, read_joints, read_targets, tangent_changes
from solari_vk.scene.files.gltf.draco import DracoMeshes
from solari_vk.scene.files.gltf.points_and_lines import DRAWN_LINES, DRAWN_POINTS, with_surface
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, WholeFileError
from solari_vk.scene.material import TEXTURES
from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.smoothing import area_vectors, fitted_normals
from solari_vk.scene.meshes.tangents import fitted_tangents, generate_tangents
from solari_vk.scene.model import Material, Mesh, Texture

# glTF 2.0, 5.24 (Mesh.Primitive): 0 are points, 1 to 3 lines, their loops and strips, 4 to 6 triangles.
_TRIANGLES = 4
_TRIANGLE_FAN = 6
WRONG_PRIMITIVES = "primitives with wrong data are left out"
_WORKING_BYTES = 300  # a triangle, for its area and tangents
_HARMLESS = ("KHR_materials_variants", "KHR_draco_mesh_compression", "KHR_xmp_json_ld")


class Primitives:
    """Creates the meshes of the scene; primitives with the same data share a mesh."""

    def __init__(self, accessors: Accessors, draco: DracoMeshes, report: Report) -> None:
        self._accessors = accessors
        self._draco = draco
        self._report = report
        self._meshes: dict[Any, Mesh | None] = {}

    def mesh(
        self, primitive: Entry, name: str, materials: list[Material], uv_sets: tuple[int, ...], skinned: bool
    ) -> Mesh | None:
        """The primitive as a mesh with all that these materials need, or None (reported) if it has no surface.

        It has tangents for the first material with a normal map. uv_sets: `Textures.uv_sets`. skinned: with joints.
        Raises SolariError for wrong data.
        """
        _refuse_compressed_splats(primitive)
        attributes = primitive.entry("attributes")
        if attributes is None:
            raise primitive.error("has no 'attributes'; export the file again")
        normal_maps = [material.normal_texture for material in materials]
        normal_map = next(filter(None, normal_maps), None)
        uvs = [f"TEXCOORD_{number}" for number in uv_sets]
        mode = primitive.integer("mode", _TRIANGLES, high=_TRIANGLE_FAN)
        packed = self._draco.unpack(primitive, attributes)
        if packed is not None:
            mode = _TRIANGLES  # strips, which the extension allows too, are triangles after decompression
        targets = primitive.entries("targets", "target")
        joints = [name for name in sorted(attributes.data) if skinned and name.startswith(("JOINTS_", "WEIGHTS_"))]
        key = (
            # What two primitives have in common if they make the same mesh: accessors and tangents.
            *(attributes.index(a) for a in ("POSITION", "NORMAL", "TANGENT", "COLOR_0", *uvs)),
            primitive.index("indices"),
            packed,
            mode,
            None if normal_map is None else normal_map.tangent_frame,
            *map(attributes.index, joints),
            tuple(tuple(sorted((k, str(v)) for k, v in target.data.items())) for target in targets),
        )
        if key not in self._meshes:
            self._meshes[key] = self._make(primitive, attributes, mode, name, uvs, normal_map, skinned, targets)
        self._remark(primitive, attributes, materials, uvs)
        return self._meshes[key]

    def find_data(self, primitive: Entry) -> None:
        """Raise WholeFileError if the positions of a primitive are in no buffer that there is. Its other errors come
        with its mesh."""
        try:
            attributes = primitive.entry("attributes")
            position = attributes.index("POSITION") if attributes else None
            if attributes and position is not None:
                self._accessors.find_data(position, attributes)
        except (BudgetError, WholeFileError):
            raise
        except SolariError:
            return

    def _remark(self, primitive: Entry, attributes: Entry, materials: list[Material], uvs: list[str]) -> None:
        self._report.add_extensions(primitive, _HARMLESS)
        textures = [getattr(material, slot) for material in materials for slot in TEXTURES]
        for name in sorted({uvs[texture.uv_set] for texture in textures if texture is not None}):
            if name not in attributes:
                replaced = uvs[0] in attributes
                effect = f"use {uvs[0]} in its place" if replaced else "see their textures at a single point"
                self._report.add(f"meshes without {name} {effect}", primitive.place)

    def _make(
        self,
        primitive: Entry,
        attributes: Entry,
        mode: int,
        name: str,
        uvs: list[str],
        normal_map: Texture | None,
        skinned: bool,
        targets: list[Entry],
    ) -> Mesh | None:
        vertices = self._vertices(primitive, attributes, uvs)
        if vertices is None:
            return None
        corners = self._corners(primitive, len(vertices["POSITION"]))
        moved = self._moved(vertices, attributes, targets, skinned)
        vertices |= moved
        _check_extent(primitive, vertices["POSITION"])
        if mode < _TRIANGLES:
            vertices, triangles = self._thin(primitive, mode, vertices, corners)
            _charge(primitive, vertices, len(triangles))
        else:
            _charge(primitive, vertices, len(corners) // 3 if mode == _TRIANGLES else max(len(corners) - 2, 0))
            triangles = self._triangles(primitive, mode, corners)
        vertices, triangles = _without_unused(vertices, triangles)
        cross = area_vectors(vertices["POSITION"], triangles)
        # Triangles that joints or targets move may get an area later.
        if not (cross.any() or (moved and len(triangles))):
            self._report.add("primitives without any triangle of some area are left out", primitive.place)
            return None
        if "NORMAL" in vertices:
            vertices["NORMAL"] = self._unit_normals(vertices["NORMAL"], triangles, cross, primitive)
        frame = 0
        if mode >= _TRIANGLES:
            vertices, triangles, frame = self._with_tangents(vertices, triangles, cross, uvs, normal_map, targets)
        first, second, *others = (vertices.get(name) for name in uvs)
        return Mesh(
            positions=vertices["POSITION"],
            triangles=triangles,
            normals=vertices.get("NORMAL"),
            uvs=first,
            second_uvs=second,
            more_uvs=_stacked(others, first),
            tangents=vertices.get("TANGENT"),
            tangent_frame=frame,
            colors=vertices.get("COLOR"),
            deformation=deformation_of(vertices),
            name=name,
        )

    def _moved(self, vertices: Vertices, attributes: Entry, targets: list[Entry], skinned: bool) -> Vertices:
        """What morph targets and, of a skinned mesh, joints do to each vertex."""
        moved = read_targets(vertices, targets, self._accessors, self._report)
        if skinned:
            with self._report.costs("primitives with wrong joints or weights rest in the pose of their vertices"):
                moved |= read_joints(len(vertices["POSITION"]), attributes, self._accessors)
        return moved

    def _vertices(self, primitive: Entry, attributes: Entry, uvs: list[str]) -> Vertices | None:
        position = attributes.index("POSITION")
        if position is None:
            self._report.add("primitives without POSITION are left out", primitive.place)
            return None
        wanted = {
            "POSITION": (position, ("VEC3",)),
            "NORMAL": (attributes.index("NORMAL"), ("VEC3",)),
            "TANGENT": (attributes.index("TANGENT"), ("VEC4",)),
            "COLOR": (attributes.index("COLOR_0"), ("VEC3", "VEC4")),
            **{name: (attributes.index(name), ("VEC2",)) for name in uvs},
        }
        count = self._accessors.count(position, attributes)
        vertices = {}
        for name, (index, kinds) in wanted.items():
            if index is None:
                continue
            # Without positions there is nothing to show: their error is the primitive's.
            with self._report.costs("wrong attributes are left out") if name != "POSITION" else nullcontext():
                rows = self._accessors.count(index, attributes)
                if rows != count:
                    raise primitive.error(f"has {rows} of {name} for {count} positions; export the file again")
                vertices[name] = self._accessors.floats(index, attributes, kinds)
        if "NORMAL" not in vertices:
            vertices.pop("TANGENT", None)  # as glTF demands: tangents need the normals that they were made for
        return self._with_colors(vertices, primitive)

    def _with_colors(self, vertices: Vertices, primitive: Entry) -> Vertices:
        """With colors from 0 to 1, and without those that change nothing."""
        if "COLOR" in vertices:
            raw = vertices.pop("COLOR")
            # glTF 2.0, 3.9.2: COLOR_0 multiplies the base color, so that white colors change nothing.
            colors = raw.clip(0, 1)
            if (colors != raw).any():
                self._report.add("vertex colors below 0 or above 1 are clamped", primitive.place)
            if (colors != 1).any():
                vertices["COLOR"] = colors
        return vertices

    def _corners(self, primitive: Entry, count: int) -> NDArray[np.uint32]:
        index = primitive.index("indices")
        number = count if index is None else self._accessors.count(index, primitive)
        primitive.charge(0, f"{number:,} corners", working=4 * number)
        if index is None:
            return np.arange(count, dtype=np.uint32)
        corners = self._accessors.integers(index, primitive, ("SCALAR",))[:, 0].astype(np.uint32)
        if len(corners) and int(corners.max()) >= count:
            raise primitive.error(
                f"refers to vertex {corners.max()} (accessor {index}), but has only {count}; export the file again"
            )
        return corners

    def _thin(
        self, primitive: Entry, mode: int, vertices: Vertices, corners: NDArray[np.uint32]
    ) -> tuple[Vertices, NDArray[np.uint32]]:
        """Vertices and triangles of points and lines."""
        self._report.add(DRAWN_POINTS if mode == 0 else DRAWN_LINES, primitive.place)
        vertices, triangles, step = with_surface(vertices, corners, mode, primitive)
        if step > 1:
            self._report.add(f"only one of {step} points or lines is drawn", primitive.place)
        return vertices, triangles

    def _triangles(self, primitive: Entry, mode: int, corners: NDArray[np.uint32]) -> NDArray[np.uint32]:
        if mode == _TRIANGLES:
            # One or two corners at the end are skipped, as graphics interfaces do.
            whole = len(corners) // 3 * 3
            if whole != len(corners):
                self._report.add("the last corners make no whole triangle and are left out", primitive.place)
            return corners[:whole].reshape(-1, 3)
        if len(corners) < 3:
            return np.zeros((0, 3), np.uint32)
        if mode == _TRIANGLE_FAN:
            # glTF 2.0, 3.7.2.1: triangle i of a fan has the vertices i + 1, i + 2 and 0.
            return np.stack([corners[1:-1], corners[2:], np.broadcast_to(corners[0], len(corners) - 2)], axis=1)
        strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        # In a strip every second triangle has the other winding order (glTF 2.0, 3.7.2.1).
        strip[1::2] = strip[1::2, [0, 2, 1]]
        return strip

    def _unit_normals(
        self, normals: NDArray[np.float32], triangles: NDArray[np.uint32], cross: NDArray[np.float64], place: Entry
    ) -> NDArray[np.float32]:
        fitted, missing = fitted_normals(normals, triangles, cross)
        if missing:
            self._report.add("normals of zero length are replaced by those of the triangles around", place.place)
        return fitted

    def _with_tangents(
        self,
        vertices: Vertices,
        triangles: NDArray[np.uint32],
        cross: NDArray[np.float64],
        names: list[str],
        normal_map: Texture | None,
        targets: list[Entry],
    ) -> tuple[Vertices, NDArray[np.uint32], int]:
        """Vertices with the tangents that a normal map needs, the triangles over them, and the tangents' frame. names:
        of the attributes with uvs."""
        normals = vertices.get("NORMAL")
        if "TANGENT" in vertices and normals is not None:
            vertices["TANGENT"] = fitted_tangents(vertices["TANGENT"], normals)
        if normal_map is None or "TANGENT" in vertices:
            return vertices, triangles, 0
        uvs = names[normal_map.uv_set]
        if uvs not in vertices:
            uvs = names[0]
        if uvs not in vertices:
            return vertices, triangles, 0
        if normals is None and ("targets" in vertices or "joints" in vertices):
            # Flat normals are those of triangles in their pose (glTF 2.0, 3.7.2.2), and so are tangents: shaders
            # compute both.
            return vertices, triangles, 0
        if normals is None:  # flat shading: every corner has the normal of its triangle
            vertices = {attribute: values[triangles.reshape(-1)] for attribute, values in vertices.items()}
            normals = np.repeat(unit(cross), 3, axis=0).astype(np.float32)
            triangles = np.arange(triangles.size, dtype=np.uint32).reshape(-1, 3)
        # Tangents are along the u of the texture, after KHR_texture_transform has turned it.
        linear = normal_map.uv_transform[:, :2].astype(np.float64)
        split = generate_tangents(vertices["POSITION"], normals, vertices[uvs] @ linear.T, triangles)
        vertices = {attribute: values[split.source] for attribute, values in vertices.items()}
        vertices["TANGENT"] = split.tangents
        if "targets" in vertices:
            turned_uvs = vertices[uvs] @ linear.T
            vertices["target_tangents"] = tangent_changes(vertices, turned_uvs, split.indices, targets)
        return vertices, split.indices, normal_map.tangent_frame


def _charge(primitive: Entry, vertices: Vertices, triangle_count: int) -> None:
    size = sum(values.nbytes for values in vertices.values()) + 12 * triangle_count
    primitive.charge(2 * size, "its mesh", working=_WORKING_BYTES * triangle_count)


def _refuse_compressed_splats(primitive: Entry) -> None:
    splats = primitive.extension("KHR_gaussian_splatting")
    if splats is not None and any("compression" in kind for kind in splats.extensions()):
        raise primitive.error("has compressed Gaussian splats, which aren't read: decompress them")


def _check_extent(primitive: Entry, positions: NDArray[np.float32]) -> None:
    if len(positions) and not np.abs(positions).max() <= checks.LARGEST_COORDINATE:
        raise primitive.error(f"has coordinates above {checks.LARGEST_COORDINATE:g} meters; scale it down")


def _without_unused(vertices: Vertices, triangles: NDArray[np.uint32]) -> tuple[Vertices, NDArray[np.uint32]]:
    """Vertices and triangles without triangles that have a vertex twice, and without vertices that no triangle has."""
    count = len(vertices["POSITION"])
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    used, triangles = _compact(triangles[distinct], count)
    if len(used) < count:
        vertices = {attribute: values[used] for attribute, values in vertices.items()}
    return vertices, triangles


def _stacked(sets: list[NDArray[np.float32] | None], first: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
    """Sets of uvs (S, N, 2), the first one in place of those that there aren't; None if there are none."""
    there = [uvs for uvs in sets if uvs is not None]
    if not there:
        return None
    fallback = np.zeros_like(there[0]) if first is None else first
    return np.stack([fallback if uvs is None else uvs for uvs in sets])


def _compact(triangles: NDArray[np.uint32], count: int) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """The vertices that triangles use, ascending, and the triangles over only these."""
    # Sorting few corners is faster than flags for many vertices.
    if count > 4 * triangles.size:  # the primitive uses a small part of a large shared buffer
        used, compact = np.unique(triangles, return_inverse=True)
        return used, compact.reshape(-1, 3).astype(np.uint32)
    flags = np.zeros(count, bool)
    flags[triangles] = True
    return np.flatnonzero(flags), (np.cumsum(flags, dtype=np.uint32) - np.uint32(1))[triangles]
