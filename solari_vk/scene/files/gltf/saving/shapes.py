"""Meshes of a scene as glTF has them: each with one primitive."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.deform import TARGETS
from solari_vk.scene.files.gltf.materials import VARIANTS
from solari_vk.scene.files.gltf.saving.content import Content
from solari_vk.scene.files.gltf.saving.surfaces import Surfaces
from solari_vk.scene.material import TEXTURES, Material
from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.smoothing import area_vectors, fitted_normals
from solari_vk.scene.meshes.tangents import fitted_tangents, generate_tangents
from solari_vk.scene.objects import Mesh

_MOST_OF_TWO_BYTES = 2**16 - 1  # vertices; the largest number restarts a primitive
_OF_VERTICES = ("positions", "normals", "uvs", "second_uvs", "more_uvs", "tangents", "colors")
_OF_DEFORMATIONS = ("joints", "joint_weights", "targets", "target_normals", "target_tangents")
Variants = tuple[tuple[int, Material], ...]


class Shapes:
    """Writes each mesh once for each of its materials; their arrays are shared."""

    def __init__(self, content: Content, surfaces: Surfaces) -> None:
        self._content = content
        self._surfaces = surfaces
        self._meshes: dict[Any, int] = {}
        self._attributes: dict[tuple[Mesh, str], int] = {}
        self._resting: dict[Mesh, bool] = {}
        self._tangential: dict[tuple[Mesh, int], Mesh] = {}

    def mesh(self, mesh: Mesh, material: Material, variants: Variants = ()) -> int:
        """The number of a mesh with a material. variants: numbers of variants, and the materials there."""
        key = mesh, material, variants
        if key not in self._meshes:
            users = (material, *(other for _, other in variants))
            mesh = self._with_tangents(mesh, users)
            # Tangents of one texture's uvs would count for all of them; who reads the file makes them again.
            has_tangents = mesh.tangent_frame == 0 or all(user.normal_texture is None for user in users)
            textures = [getattr(user, name) for user in users for name in TEXTURES]
            uv_sets = {texture.uv_set for texture in textures if texture is not None}
            primitive: dict[str, Any] = {
                "attributes": self._all(mesh, uv_sets, has_tangents),
                "indices": self._once(mesh, "indices", mesh.triangles.reshape(-1), *self._corner_kind(mesh)),
                "material": self._surfaces.material(material),
            }
            if variants:
                mappings = [{"material": self._surfaces.material(other), "variants": [v]} for v, other in variants]
                self._content.use(VARIANTS, {"mappings": mappings}, primitive)
            targets = self._targets(mesh)
            if targets:
                primitive["targets"] = targets
            self._meshes[key] = self._content.add("meshes", name=mesh.name, primitives=[primitive])
        return self._meshes[key]

    def _with_tangents(self, mesh: Mesh, materials: Sequence[Material]) -> Mesh:
        """The mesh, with tangents if textures need them and the file would have nothing to make them of: glTF demands
        them of coats' normal maps and anisotropy without a normal map."""
        needing = (
            m.clearcoat_normal_texture or m.anisotropy_texture
            for m in materials
            if not m.unlit and m.normal_texture is None
        )
        texture = next((texture for texture in needing if texture is not None), None)
        if texture is None:
            return mesh
        key = mesh, texture.uv_set
        if key not in self._tangential:
            self._tangential[key] = _split_with_tangents(mesh, texture.uv_set)
        return self._tangential[key]

    def has_resting(self, mesh: Mesh) -> bool:
        """Whether some vertices have no joint, of a mesh with joints: they stay, by one more joint."""
        if mesh not in self._resting:
            weights = None if mesh.deformation is None else mesh.deformation.joint_weights
            self._resting[mesh] = weights is not None and not (weights > 0).any(axis=1).all()
        return self._resting[mesh]

    @staticmethod
    def _corner_kind(mesh: Mesh) -> tuple[str, str]:
        # 65535 itself restarts a primitive (glTF 2.0, 3.7.2.1), so that 65535 vertices are the most for two bytes.
        return "u2" if len(mesh.positions) <= _MOST_OF_TWO_BYTES else "u4", "corners"

    def _once(self, mesh: Mesh, name: str, values: NDArray[Any], dtype: str = "f4", use: str = "vertices") -> int:
        """The accessor of an attribute."""
        if (mesh, name) not in self._attributes:
            self._attributes[mesh, name] = self._content.accessor(values, dtype, use)
        return self._attributes[mesh, name]

    def _all(self, mesh: Mesh, uv_sets: set[int], has_tangents: bool) -> dict[str, int]:
        found = {"POSITION": self._once(mesh, "POSITION", mesh.positions, use="positions")}
        if mesh.normals is not None:
            # glTF 2.0, 3.7.2.1: normals and tangents have length 1; triangles without normals are flat.
            normals, _ = fitted_normals(mesh.normals, mesh.triangles, area_vectors(mesh.positions, mesh.triangles))
            found["NORMAL"] = self._once(mesh, "NORMAL", normals)
            if mesh.tangents is not None and has_tangents:
                found["TANGENT"] = self._once(mesh, "TANGENT", fitted_tangents(mesh.tangents, normals))
        elif mesh.tangents is not None and has_tangents:
            self._content.lose("tangents of meshes without normals aren't written", mesh.describe())
        if mesh.colors is not None:
            found["COLOR_0"] = self._once(mesh, "COLOR_0", mesh.colors)
        return found | self._uvs(mesh, uv_sets) | self._joints(mesh)

    def _uvs(self, mesh: Mesh, uv_sets: set[int]) -> dict[str, int]:
        """The sets of uvs that a mesh has, or that textures use."""
        found = {}
        uvs = mesh.uvs
        if uvs is None and (uv_sets or mesh.uv_set_count > 1):
            uvs = np.zeros((len(mesh.positions), 2), np.float32)  # where shaders see textures of meshes without uvs
        if uvs is not None:
            found["TEXCOORD_0"] = self._once(mesh, "TEXCOORD_0", uvs)
        for number in sorted({*range(1, mesh.uv_set_count), *(uv_sets - {0})}):
            own = mesh.uvs_for(number)
            name = f"TEXCOORD_{number}"
            # A mesh without such uvs has the first ones in their place.
            if own is None or own is mesh.uvs:
                found[name] = found["TEXCOORD_0"]
            else:
                found[name] = self._once(mesh, name, own)
        return found

    def _joints(self, mesh: Mesh) -> dict[str, int]:
        """Joints and weights as the format wants them: four a set, each joint once, none with the weight 0, and for
        each vertex one at least."""
        deformation = mesh.deformation
        if deformation is None or deformation.joints is None or deformation.joint_weights is None:
            return {}
        joints, weights = deformation.joints.astype(np.int64), deformation.joint_weights.astype(np.float64)
        # glTF 2.0, 3.7.3.3: a vertex has a joint once only, and unused joints are 0.
        for column in range(1, joints.shape[1]):
            for earlier in range(column):
                same = joints[:, column] == joints[:, earlier]
                weights[same, earlier] += weights[same, column]
                weights[same, column] = 0
        padding = ((0, 0), (0, -joints.shape[1] % 4))
        joints, weights = np.pad(joints, padding), np.pad(weights, padding)
        resting = ~(weights > 0).any(axis=1)
        joints[weights == 0] = 0
        # Vertices without a joint follow the one that `Nodes.skin` adds, which never moves.
        joints[resting, 0] = deformation.joint_count
        weights[resting, 0] = 1
        dtype = "u1" if joints.max() < 256 else "u2"
        found = {}
        for number in range(joints.shape[1] // 4):
            part = np.s_[:, 4 * number : 4 * number + 4]
            found[f"JOINTS_{number}"] = self._once(mesh, f"JOINTS_{number}", joints[part], dtype)
            found[f"WEIGHTS_{number}"] = self._once(mesh, f"WEIGHTS_{number}", weights[part])
        return found

    def _targets(self, mesh: Mesh) -> list[dict[str, int]]:
        deformation = mesh.deformation
        if deformation is None or deformation.targets is None:
            return []
        bases = {"POSITION": mesh.positions, "NORMAL": mesh.normals, "TANGENT": mesh.tangents}
        fields = {name: getattr(deformation, field) for name, field in TARGETS.items() if bases[name] is not None}
        if mesh.normals is None:
            fields.pop("TANGENT", None)
        arrays = {name: values for name, values in fields.items() if values is not None}
        targets = []
        for number in range(deformation.target_count):
            # All are "positions", since glTF 2.0, 3.7.2.2 wants the bounds of what targets add to positions.
            accessors = {
                name: self._once(mesh, f"{name} of {number}", values[number], use="positions")
                for name, values in arrays.items()
            }
            targets.append(accessors)
        return targets


def _split_with_tangents(mesh: Mesh, uv_set: int) -> Mesh:
    """A mesh with the tangents of a set of uvs, as MikkTSpace makes them, and flat normals if it has none.

    Meshes that have tangents or no uvs stay as they are, as do flat ones that are deformed.
    """
    normals = mesh.normals
    uvs = mesh.uvs_for(uv_set)
    if mesh.tangents is not None or uvs is None or (normals is None and mesh.deformation is not None):
        return mesh
    rows: NDArray[Any] = np.arange(len(mesh.positions))
    triangles: NDArray[Any] = mesh.triangles
    if normals is None:
        # Each triangle gets vertices of its own.
        rows = triangles.reshape(-1)
        triangles = np.arange(triangles.size).reshape(-1, 3)
        normals = np.repeat(unit(area_vectors(mesh.positions, mesh.triangles)), 3, axis=0)
    split = generate_tangents(mesh.positions[rows], normals, uvs[rows], triangles)
    made = _with_vertices(mesh, rows[split.source], split.indices)
    return dataclasses.replace(made, normals=normals[split.source], tangents=split.tangents)


def _with_vertices(mesh: Mesh, rows: NDArray[Any], triangles: NDArray[Any]) -> Mesh:
    """The mesh of these vertices, with triangles over them."""
    attributes = {name: getattr(mesh, name) for name in _OF_VERTICES}
    parts = {name: values[..., rows, :] for name, values in attributes.items() if values is not None}
    if mesh.deformation is not None:
        arrays = {name: getattr(mesh.deformation, name) for name in _OF_DEFORMATIONS}
        moved = {name: values[..., rows, :] for name, values in arrays.items() if values is not None}
        parts["deformation"] = dataclasses.replace(mesh.deformation, **moved)
    return dataclasses.replace(mesh, triangles=triangles, **parts)
