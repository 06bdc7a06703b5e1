"""What the memory of a mesh on the device is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import (
    MESH_HAS_COLORS,
    MESH_HAS_NORMALS,
    MESH_HAS_TANGENTS,
    MESH_HAS_UVS,
    MESH_SMOOTH_NORMALS,
)
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.model import Mesh

# The fields of a mesh's record that are addresses in its buffer, in the order of memory.
ADDRESSES = ("positions", "triangles", "attributes", "more_uvs", "colors")
TRIANGLES_OF_PART = 65536
LARGEST_DIFFERENCE = 1e-3  # between the normals of one flat triangle, for what files round


def pack_attributes(mesh: Mesh, layout: np.dtype[Any]) -> tuple[int, NDArray[Any] | None]:
    """The flags of the attributes that a mesh has, and the attributes as records if there are any."""
    flags = 0
    attributes = np.zeros(len(mesh.positions), layout)
    for flag, name, values in (
        (MESH_HAS_NORMALS, "normal", mesh.normals),
        (MESH_HAS_UVS, "uv", mesh.uvs),
        (MESH_HAS_TANGENTS, "tangent", mesh.tangents),
    ):
        if values is not None:
            attributes[name] = values
            flags |= flag
    return flags, attributes if flags else None


def has_smooth_normals(mesh: Mesh) -> bool:
    """Whether the corners of a triangle differ in their normals."""
    if mesh.normals is None:
        return False
    # in parts, since most meshes with such normals have them on their first triangles
    for first in range(0, len(mesh.triangles), TRIANGLES_OF_PART):
        corners = mesh.normals[mesh.triangles[first : first + TRIANGLES_OF_PART]]
        if np.any(np.abs(corners - corners[:, :1]) > LARGEST_DIFFERENCE):
            return True
    return False


def mesh_parts(mesh: Mesh, triangles: NDArray[np.uint32], layout: np.dtype[Any]) -> tuple[int, dict[str, NDArray[Any]]]:
    """A mesh's flags, and what its addresses point to, in the order of memory: positions, triangles in the order that
    is given, and other attributes if there are any. layout: of the attributes' records."""
    flags, attributes = pack_attributes(mesh, layout)
    if has_smooth_normals(mesh):
        flags |= MESH_SMOOTH_NORMALS
    parts: dict[str, NDArray[Any]] = {"positions": mesh.positions, "triangles": triangles}
    if attributes is not None:
        parts["attributes"] = attributes
    sets = [mesh.uvs_for(uv_set) for uv_set in range(1, mesh.uv_set_count)]
    if sets:
        parts["more_uvs"] = np.array([np.zeros((len(mesh.positions), 2), np.float32) if s is None else s for s in sets])
    if mesh.colors is not None:
        # Colors without alpha are opaque.
        parts["colors"] = np.ones((len(mesh.positions), 4), np.float32)
        parts["colors"][:, : mesh.colors.shape[1]] = mesh.colors
        flags |= MESH_HAS_COLORS
    return flags, parts


def copy_of_positions(device: Device, buffer: Buffer, count: int) -> Buffer:
    """A copy of the positions that the memory of a mesh begins with."""
    copy = device.buffer(12 * count, "earlier positions")

    def record(commands: raw.CData) -> None:
        device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
        buffer.record_copy(commands, copy.handle, size=copy.size)
        device.vk.vkCmdPipelineBarrier2(commands, full_barrier())

    device.start(record, copy.name)
    return copy
