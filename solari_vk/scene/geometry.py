"""Meshes on the device: vertex and index buffers, and acceleration structures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.scene.constants import MESH_HAS_NORMALS, MESH_HAS_TANGENTS, MESH_HAS_UVS
from solari_vk.scene.features import Features
from solari_vk.scene.model import Mesh
from solari_vk.scene.observed import Observable
from solari_vk.scene.spatial import spatial_order
from solari_vk.scene.table import Rows, Table


class Geometry:
    """The `meshes` table and everything its addresses point to."""

    def __init__(
        self, device: Device, record: np.dtype[Any], attributes: np.dtype[Any], features: Features, watcher: Any
    ) -> None:
        self.table = Table(device, "meshes", record)
        self.rows: Rows[Mesh] = Rows()
        self._ray_users: Rows[Mesh] = Rows()
        self._attributes = attributes
        self._device = device
        self._features = features
        self._watcher = watcher
        self._buffers: dict[Mesh, Buffer] = {}
        self.centers: dict[Mesh, NDArray[np.float32]] = {}
        """The center (3,) of each uploaded mesh's bounds, in object space."""
        self.half_sizes: dict[Mesh, NDArray[np.float32]] = {}
        """Half the size (3,) of the same bounds."""
        self.orders: dict[Mesh, NDArray[np.int64]] = {}
        """For each uploaded mesh the mesh's triangle of each uploaded triangle."""
        self.blases: dict[Mesh, Blas] = {}
        """The acceleration structure of each traced mesh, as of the latest `update`."""
        self._to_upload: dict[Mesh, None] = {}
        self.kept = True
        """Whether no acceleration structure was destroyed since this was last set."""

    def acquire(self, mesh: Mesh, user: Observable, *, traced: bool) -> None:
        """Add a use of a mesh. traced: rays hit it, so it needs an acceleration structure."""
        if self.rows.acquire(mesh, user):
            mesh.watch(self._watcher)
            self._to_upload[mesh] = None
        if traced and self._ray_users.acquire(mesh, user):
            self._to_upload[mesh] = None

    def release(self, mesh: Mesh, user: Observable, *, traced: bool) -> None:
        """Undo one `acquire`."""
        if traced and self._ray_users.release(mesh, user) and mesh in self.blases:
            self.blases.pop(mesh).destroy()
            self.kept = False
        if self.rows.release(mesh, user):
            mesh.unwatch(self._watcher)
            self._to_upload.pop(mesh, None)
            if mesh in self._buffers:
                self._buffers.pop(mesh).destroy()
                del self.centers[mesh], self.half_sizes[mesh], self.orders[mesh]

    def change(self, mesh: Mesh) -> list[Any]:
        """Take note of an edit of a mesh, which must be uploaded again; returns the instances that use it."""
        if mesh not in self.rows:
            return []
        self._to_upload[mesh] = None
        return self.rows.users(mesh)

    def update(self) -> None:
        """Upload new and changed meshes and build their acceleration structures."""
        if not self._to_upload:
            return
        self.table.reserve(self.rows.limit)
        blases = {}
        with self._device.uploads() as uploads:
            for mesh in self._to_upload:
                self._features.note(mesh)
                geometry = self._upload(mesh, uploads)
                if mesh in self._ray_users:
                    blases[mesh] = Blas(self._device, [geometry], name=mesh.name or "mesh")
        build_blases(self._device, list(blases.values()))
        for mesh, blas in blases.items():
            if mesh in self.blases:
                self.blases[mesh].destroy()
                self.kept = False
            self.blases[mesh] = blas
        self._to_upload.clear()

    def _upload(self, mesh: Mesh, uploads: Uploads) -> TriangleGeometry:
        """Upload a mesh as one buffer: positions, triangles in spatial order, and other attributes if there are any."""
        triangles = mesh.triangles
        corners = mesh.positions[triangles]
        order = self.orders[mesh] = spatial_order(corners.mean(axis=1))
        triangles = triangles[order]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.centers[mesh], self.half_sizes[mesh] = (low + high) / 2, (high - low) / 2
        parts = [mesh.positions, triangles]
        flags = 0
        if any(part is not None for part in (mesh.normals, mesh.uvs, mesh.tangents)):
            attributes = np.zeros(len(mesh.positions), self._attributes)
            for flag, name, values in (
                (MESH_HAS_NORMALS, "normal", mesh.normals),
                (MESH_HAS_UVS, "uv", mesh.uvs),
                (MESH_HAS_TANGENTS, "tangent", mesh.tangents),
            ):
                if values is not None:
                    attributes[name] = values
                    flags |= flag
            parts.append(attributes)
        name = mesh.name or "mesh"
        buffer = self._device.buffer(sum(part.nbytes for part in parts), name)
        offsets = []
        offset = 0
        for part in parts:
            offsets.append(buffer.address + offset)
            uploads.buffer(buffer, part, offset)
            offset += part.nbytes
        if mesh in self._buffers:
            self._buffers[mesh].destroy()
        self._buffers[mesh] = buffer
        record = self.table.records[self.rows[mesh]]
        record["positions"], record["triangles"] = offsets[:2]
        record["attributes"] = offsets[2] if flags else 0
        record["triangle_count"] = len(triangles)
        record["flags"] = flags
        record["bounds_min"], record["bounds_max"] = low, high
        self.table.mark([self.rows[mesh]])
        return TriangleGeometry(
            positions=offsets[0], position_count=len(mesh.positions), indices=offsets[1], triangle_count=len(triangles)
        )

    def destroy(self) -> None:
        """Free everything."""
        for blas in self.blases.values():
            blas.destroy()
        for buffer in self._buffers.values():
            buffer.destroy()
        self.table.destroy()
        for mesh in self.rows:
            mesh.unwatch(self._watcher)
