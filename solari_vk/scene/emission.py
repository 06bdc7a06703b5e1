"""How much light each triangle of an emissive mesh sends out: light samples take bright triangles more often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.color import LUMINANCE_WEIGHTS
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.alias_table import alias_table
from solari_vk.scene.images import LINEAR_OF_SRGB
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Instance, Mesh, Scene, Texture, TextureImage
from solari_vk.scene.table import Rows

Key = tuple[Mesh, Texture | None]
Sums = NDArray[np.int64]
_STEPS = 2**20  # per unit of luminance, so that sums of texels are exact
_ROUNDING = 1e-3  # in texels: coordinates on the border of a texel don't belong to its neighbor
# The least luminance of a triangle over its light's mean. Where the mean over a triangle's box misses the triangle's
# own light, this bounds the noise, and it lets reservoirs reach triangles that become bright later.
MIN_LUMINANCE = 0.1


@dataclass(frozen=True)
class Emission:
    """A mesh with an emissive texture. area: in object space, in square meters, times the texture's mean luminance.

    choices: the alias table of its triangles in the order of upload; None where all are equally likely.
    """

    area: float
    triangle_count: int
    choices: Buffer | None
    joint_areas: NDArray[np.float64] | None = None
    """The parts of `area` that each joint moves; the last one is moved by none."""

    def area_in(self, joint_matrices: NDArray[np.float64] | None) -> float:
        """The area in a pose, roughly: of triangles that one joint turns and scales evenly, exactly."""
        if joint_matrices is None or self.joint_areas is None:
            return self.area
        count = len(self.joint_areas) - 1
        scales = np.abs(np.linalg.det(joint_matrices[:count, :, :3])) ** (2 / 3)
        return float(self.joint_areas[:count] @ scales + self.joint_areas[count])


class Emissions:
    """The Emission of each pair of mesh and emissive texture in use. choice: the layout of the shaders' Choice."""

    def __init__(self, device: Device, choice: np.dtype[Any]) -> None:
        self._device = device
        self._choice = choice
        self._emissions: dict[Key, Emission] = {}
        self._users: Rows[Key] = Rows()
        self._key_of: dict[Instance, Key] = {}
        self._sums: dict[TextureImage, Sums] = {}

    def acquire(self, instance: Instance, order: NDArray[np.int64]) -> Emission:
        """The emission of an instance; order: that of its ray mesh's triangles on the device."""
        mesh, texture = key = (instance.ray_mesh or instance.mesh, instance.material.emissive_texture)
        if self._key_of.get(instance) != key:
            self._users.acquire(key, instance)
            self.release(instance)
            self._key_of[instance] = key
        if key not in self._emissions:
            self._emissions[key] = self._make(mesh, texture, order)
        return self._emissions[key]

    def release(self, instance: Instance) -> None:
        """Take note that an instance emits nothing any more."""
        key = self._key_of.pop(instance, None)
        if key is not None and self._users.release(key, instance):
            self._drop(key)

    def change(self, changed: Mesh | Texture | TextureImage) -> list[Instance]:
        """Take note of an edit; returns the instances whose emission must be acquired again."""
        users: list[Instance] = []
        for key in list(self._emissions):
            mesh, texture = key
            if changed in (mesh, texture) or (texture is not None and texture.image is changed):
                self._drop(key)
                users += self._users.users(key)
        return users

    def _drop(self, key: Key) -> None:
        emission = self._emissions.pop(key, None)
        if emission is not None and emission.choices is not None:
            emission.choices.destroy()

    def _make(self, mesh: Mesh, texture: Texture | None, order: NDArray[np.int64]) -> Emission:
        triangles = mesh.triangles[order]
        a, b, c = mesh.positions[triangles].astype(np.float64).swapaxes(0, 1)
        weights = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        area = float(weights.sum())
        if texture is not None and area > 0:
            if texture.image not in self._sums:
                self._sums[texture.image] = luminance_sums(texture.image)
            found = mean_luminances(mesh, triangles, texture, self._sums[texture.image])
            bright = float(weights @ found)
            weights *= np.maximum(found, MIN_LUMINANCE * bright / area)
            area = bright
        joint_areas = _areas_by_joint(mesh, triangles, weights)
        if mesh.deformation is not None:  # which may enlarge triangles that are tiny in the rest pose
            weights = np.maximum(weights, MIN_LUMINANCE * weights.mean())
        choices = None
        if weights.max() > weights.min() * (1 + 1e-4):
            table = alias_table(weights, self._choice)
            choices = self._device.buffer(table.nbytes, f"choices of {mesh.name or 'mesh'}")
            choices.upload(table)
        return Emission(area, len(triangles), choices, joint_areas)

    def end_update(self) -> None:
        """Free what only acquires in the same update share."""
        self._sums.clear()

    def destroy(self) -> None:
        """Free everything."""
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
    corners = np.bincount(triangles.reshape(-1), np.repeat(areas / 3, 3), len(mesh.positions))
    count = deformation.joint_count
    shares = deformation.joint_weights * corners[:, None]
    joints = np.where(deformation.joint_weights > 0, deformation.joints, count).reshape(-1)
    found: NDArray[np.float64] = np.bincount(joints, shares.reshape(-1), count + 1).astype(np.float64)
    found[count] = corners[~(deformation.joint_weights > 0).any(axis=1)].sum()
    return found


def mean_emission(scene: Scene) -> float:
    """The luminance of visible emissive surfaces, spread over the faces of the scene's bounds, in cd/m^2, roughly."""
    total = 0.0
    for instance in scene.instances:
        if instance.visible and instance.material.emits:
            mesh, texture = instance.posed_mesh(), instance.material.emissive_texture
            a, b, c = transform_points(instance.transform, mesh.positions)[mesh.triangles].swapaxes(0, 1)
            bright = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
            if texture is not None:
                sums = luminance_sums(texture.image)
                bright *= float(sums[-1, -1]) / (_STEPS * (len(sums) - 1) * (sums.shape[1] - 1))
            total += bright * float(instance.material.emissive @ np.array(LUMINANCE_WEIGHTS))
    if total == 0:
        return 0.0
    x, y, z = scene.bounds.size
    return total / (2 * float(x * y + y * z + z * x))


def luminance_sums(image: TextureImage) -> Sums:
    """The summed-area table (height + 1, width + 1) of an sRGB image's luminance, in units of 1 / _STEPS.

    Crow, "Summed-Area Tables for Texture Mapping" (1984).
    """
    height, width = image.pixels.shape[:2]
    sums = np.zeros((height + 1, width + 1), np.int64)
    texels = sums[1:, 1:]
    for channel, weight in enumerate(LUMINANCE_WEIGHTS):
        texels += np.rint(LINEAR_OF_SRGB * (weight * _STEPS)).astype(np.int64)[image.pixels[..., channel]]
    np.cumsum(texels, axis=0, out=texels)
    np.cumsum(texels, axis=1, out=texels)
    return sums


def mean_luminances(mesh: Mesh, triangles: NDArray[np.uint32], texture: Texture, sums: Sums) -> NDArray[np.float64]:
    """The mean luminance (M,) of a texture over the box of texels around each of the triangles (M, 3)."""
    m = texture.uv_transform.astype(np.float64)
    given = mesh.uvs_for(texture.uv_set)
    uvs = np.zeros((len(mesh.positions), 2)) if given is None else given.astype(np.float64)
    corners = (uvs @ m[:, :2].T + m[:, 2])[triangles]
    left, right = _texels(corners[..., 0], sums.shape[1] - 1, texture.wrap_u)
    top, bottom = _texels(corners[..., 1], sums.shape[0] - 1, texture.wrap_v)
    boxes = sums[bottom, right] - sums[bottom, left] - sums[top, right] + sums[top, left]
    means: NDArray[np.float64] = boxes / ((right - left) * (bottom - top) * float(_STEPS))
    return means


def _texels(coordinates: NDArray[np.float64], size: int, wrap: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first texel along an axis under coordinates (M, 3), and the end: all texels where the texture wraps around
    inside a triangle."""
    first = np.floor(coordinates.min(axis=1) * size + _ROUNDING)
    end = np.maximum(np.ceil(coordinates.max(axis=1) * size - _ROUNDING), first + 1)
    if wrap == "clamp_to_edge":
        return first.clip(0, size - 1).astype(np.int64), end.clip(1, size).astype(np.int64)
    period = 2 * size if wrap == "mirrored_repeat" else size
    first, length = first % period, end - first
    end = first + length
    mirrored = first >= size
    first, end = np.where(mirrored, period - end, first), np.where(mirrored, period - first, end)
    inside = (first >= 0) & (end <= size)
    return np.where(inside, first, 0).astype(np.int64), np.where(inside, end, size).astype(np.int64)
