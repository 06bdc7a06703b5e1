"""How much light each triangle of an emissive mesh sends out: light samples take bright triangles more often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.lights.alias_table import alias_tables
from solari_vk.bound.lights.clusters import Clusters
from solari_vk.bound.table import RowAllocator
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.emission import Sums, luminance_sums, mean_luminances
from solari_vk.scene.model import Instance, Material, Mesh, Texture, TextureImage
from solari_vk.scene.observable import Observable

Key = tuple[Mesh, Texture | None]
# The least luminance of a triangle over its light's mean. Where the mean over a triangle's box misses the triangle's
# own light, this bounds the noise, and it lets reservoirs reach triangles that become bright later.
MIN_LUMINANCE = 0.1


@dataclass(frozen=True)
class Emission:
    """A mesh with an emissive texture. area: in object space, in square meters, times the texture's mean luminance.

    choices: the alias tables of its clusters' triangles in the order of upload; None where all are equally likely.
    clusters: None where all triangles are one.
    """

    area: float
    triangle_count: int
    choices: Buffer | None
    joint_areas: NDArray[np.float64] | None = None
    """The parts of `area` that each joint moves; the last one is moved by none."""
    clusters: Clusters | None = None

    def area_in(self, joint_matrices: NDArray[np.float64] | None) -> float:
        """The area in a pose, roughly: of triangles that one joint turns and scales evenly, exactly."""
        if joint_matrices is None or self.joint_areas is None:
            return self.area
        count = len(self.joint_areas) - 1
        # A joint that scales by s scales areas by s^2, and volumes by s^3, which is the determinant.
        scales = np.abs(np.linalg.det(joint_matrices[:count, :, :3])) ** (2 / 3)
        return float(self.joint_areas[:count] @ scales + self.joint_areas[count])


ONE_PART = Emission(1.0, 1, None)


class Emissions:
    """The Emission of each pair of mesh and emissive texture in use. row: the layout of the shaders' AliasTableRow."""

    def __init__(self, device: Device, row: np.dtype[Any]) -> None:
        self._device = device
        self._row = row
        self._emissions: dict[Key, Emission] = {}
        self._users: RowAllocator[Key] = RowAllocator()
        self._key_of: dict[Instance, Key] = {}
        # Sums over an image take time and memory: emissions that are made in the same update share them.
        self._sums: dict[TextureImage, Sums] = {}

    def acquire(self, instance: Instance, order: NDArray[np.int64]) -> Emission:
        """The emission of an instance; order: that of its ray mesh's triangles on the device."""
        mesh = instance.ray_mesh or instance.mesh
        texture = instance.material.emissive_texture
        key = mesh, texture
        if self._key_of.get(instance) != key:
            # Acquired before the other one is released, so that what both share stays.
            self._users.acquire(key, instance)
            self.release(instance)
            self._key_of[instance] = key
        if key not in self._emissions:
            self._emissions[key] = self._make(mesh, texture, order)
        return self._emissions[key]

    def release(self, instance: Instance) -> None:
        """Release the emission of an instance that emits nothing any more."""
        key = self._key_of.pop(instance, None)
        if key is not None and self._users.release(key, instance):
            self._drop(key)

    def drop_edited(self, changed: Mesh | Texture | TextureImage) -> list[Instance]:
        """Drop what depends on an edited object; returns the instances that must acquire their emission again."""
        users: list[Instance] = []
        for key in list(self._emissions):
            mesh, texture = key
            if changed in (mesh, texture) or (texture is not None and texture.image is changed):
                self._drop(key)
                users += self._users.users(key)
        return users

    def depend_on(self, item: Observable) -> bool:
        """Whether an instance emits by the triangles of a mesh, or as an image says."""
        return not isinstance(item, Material) and any(
            mesh is item or (texture is not None and texture.image is item) for mesh, texture in self._users
        )

    def _drop(self, key: Key) -> None:
        emission = self._emissions.pop(key, None)
        if emission is not None and emission.choices is not None:
            emission.choices.destroy()

    def _make(self, mesh: Mesh, texture: Texture | None, order: NDArray[np.int64]) -> Emission:
        # In the order of upload, in which clusters are runs of neighbors.
        triangles = mesh.triangles[order]
        a, b, c = (mesh.positions[corner].astype(np.float64) for corner in triangles.T)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        weights = areas
        area = float(areas.sum())
        if texture is not None and area > 0:
            if texture.image not in self._sums:
                self._sums[texture.image] = luminance_sums(texture.image)
            luminances = mean_luminances(mesh, triangles, texture, self._sums[texture.image])
            bright_area = float(areas @ luminances)
            weights = areas * np.maximum(luminances, MIN_LUMINANCE * bright_area / area)
            area = bright_area
        joint_areas = _areas_by_joint(mesh, triangles, weights)
        # A pose may enlarge triangles that are tiny in the rest pose.
        if mesh.deformation is not None:
            weights = np.maximum(weights, MIN_LUMINANCE * weights.mean())
        clusters = Clusters(mesh, triangles, areas, weights)
        choices = None
        # Without a table all triangles of a cluster are equally likely.
        if weights.max() > weights.min() * (1 + 1e-4) and len(clusters.starts) < len(triangles):
            table = alias_tables(weights, clusters.starts, self._row)
            with self._device.undone_on_error():
                choices = self._device.buffer(table.nbytes, f"choices of {mesh.name or 'mesh'}")
                choices.upload(table)
        return Emission(area, len(triangles), choices, joint_areas, clusters if len(clusters.starts) > 1 else None)

    def end_update(self) -> None:
        """Free what only acquires in the same update share."""
        self._sums.clear()

    def destroy(self) -> None:
        for key in list(self._emissions):
            self._drop(key)


def _areas_by_joint(
    mesh: Mesh, triangles: NDArray[np.uint32], areas: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """How much of the areas (M,) of triangles (M, 3) each joint moves (J + 1,), the last for no joint; None without
    joints."""
    deformation = mesh.deformation
    if deformation is None or deformation.joints is None or deformation.joint_weights is None:
        return None
    # A vertex has a third of each of its triangles, and its joints share that by their weights.
    corners = np.bincount(triangles.reshape(-1), np.repeat(areas / 3, 3), len(mesh.positions))
    count = deformation.joint_count
    shares = deformation.joint_weights * corners[:, None]
    joints = np.where(deformation.joint_weights > 0, deformation.joints, count).reshape(-1)
    found: NDArray[np.float64] = np.bincount(joints, shares.reshape(-1), count + 1).astype(np.float64)
    found[count] = corners[~(deformation.joint_weights > 0).any(axis=1)].sum()
    return found
