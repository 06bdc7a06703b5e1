"""Meshes on the device: vertex and index buffers, and acceleration structures.

The vertices of a mesh in the pose of an instance are computed on the device: bound/scene_poses.py.
"""

from __future__ import annotations

import weakref
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import MESH_SMOOTH_NORMALS
from solari_vk.bound.features import SMOOTH_NORMALS, Features
from solari_vk.bound.mesh_parts import ADDRESSES, copy_of_positions, mesh_parts, pack_attributes
from solari_vk.bound.mesh_structures import MeshStructures
from solari_vk.bound.mesh_tensors import MeshTensors
from solari_vk.bound.posed_mesh import PosedMesh
from solari_vk.bound.scene_poses import ScenePoses
from solari_vk.bound.spatial_order import memory_order
from solari_vk.bound.table import RowAllocator, Table, content_of
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.gpu.structures import MeshStructure
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.gpu.trees.refits import MovedTrees
from solari_vk.scene.model import Instance, Mesh

DeviceMesh = Mesh | PosedMesh
"""What has a row of the table `meshes`: a mesh as it was given, or in the pose of an instance."""
# The fields of a mesh that the device has; equal ones share memory.
ARRAYS = ("positions", "triangles", "normals", "uvs", "tangents", "second_uvs", "more_uvs", "colors")


class Geometry:
    """The `meshes` table and everything its addresses point to. block_dtypes: of the shaders' blocks, by name."""

    def __init__(
        self, device: Device, block_dtypes: dict[str, Any], features: Features, watcher: Any, port: TensorPort
    ) -> None:
        self.table = Table(device, "meshes", block_dtypes["meshes"])
        self.moved_trees = MovedTrees(device)
        """Is called at the end of each update of the scene."""
        self.posed = ScenePoses(device, block_dtypes, self.table, self.moved_trees)
        self.rows: RowAllocator[DeviceMesh] = RowAllocator()
        self._ray_users: RowAllocator[DeviceMesh] = RowAllocator()
        # Those that are used, or will be: an update that fails before it uses one must not keep it.
        self._posed_meshes: weakref.WeakValueDictionary[tuple[Mesh, Instance], PosedMesh] = (
            weakref.WeakValueDictionary()
        )
        self._attributes = block_dtypes["vertex_attributes"]
        self.tensors = MeshTensors(device, port, self.table, self.rows, self._attributes, self.moved_trees)
        self.structures = MeshStructures(device, self.tensors)
        self._device = device
        self._features = features
        self._watcher = watcher
        self._buffers: dict[Mesh, Buffer] = {}
        # Meshes with equal arrays share a buffer. An edited mesh has a content of its own, equal to no other.
        self._contents: RowAllocator[Hashable] = RowAllocator()
        self._content_of: dict[Mesh, Hashable] = {}
        self._uploaded: dict[Mesh, dict[str, Any]] = {}  # the mesh's arrays at its upload, if nothing failed
        self.centers: dict[DeviceMesh, NDArray[np.float32]] = {}
        """The center (3,) of each uploaded mesh's bounds, in object space."""
        self.half_sizes: dict[DeviceMesh, NDArray[np.float32]] = {}
        """Half the size (3,) of the same bounds."""
        self.orders: dict[DeviceMesh, NDArray[np.int64]] = {}
        """For each uploaded mesh the mesh's triangle of each uploaded triangle."""
        self.blases: dict[DeviceMesh, MeshStructure] = {}
        """The acceleration structure of each traced mesh, as of the latest `update`."""
        # Blended meshes, whose light is added per hit: rays must meet each of their triangles only once.
        self._no_duplicate_any_hit: set[Mesh] = set()
        self._to_upload: dict[Mesh, None] = {}
        self._moved: set[Mesh] = set()  # of these, those that have other positions

    def device_mesh(self, mesh: Mesh, instance: Instance) -> DeviceMesh:
        """An instance's mesh in its pose, or the mesh if it has none. The pose is that of the instance now."""
        if not instance.posed or mesh.deformation is None:
            return mesh
        # The mesh may have been edited since the pose was assigned, and no longer fit it.
        pose = instance.joint_matrices, instance.morph_weights
        mesh.deformation.check(len(mesh.positions), *pose, instance.describe())
        device_mesh = self._posed_meshes.setdefault((mesh, instance), PosedMesh(mesh, instance))
        self.posed.follow_instance(device_mesh)
        return device_mesh

    def acquire(self, device_mesh: DeviceMesh, user: Instance, *, traced: bool) -> None:
        """Add a use of a mesh. traced: rays hit it, so it needs an acceleration structure."""
        if isinstance(device_mesh, PosedMesh):
            self.rows.acquire(device_mesh, user)
            self._posed_meshes[device_mesh.mesh, device_mesh.instance] = device_mesh
            self.posed.add(device_mesh, self.rows[device_mesh], traced)
            self.acquire(device_mesh.mesh, user, traced=False)
            return
        if self.rows.acquire(device_mesh, user):
            device_mesh.watch(self._watcher)
            self._to_upload[device_mesh] = None
        if traced and self._ray_users.acquire(device_mesh, user):
            self.mark_changed(device_mesh)  # its acceleration structure is built with an upload

    def release(self, device_mesh: DeviceMesh, user: Instance, *, traced: bool) -> None:
        """Undo one `acquire`."""
        if isinstance(device_mesh, PosedMesh):
            if self.rows.release(device_mesh, user):
                self._remove_posed(device_mesh)
            self.release(device_mesh.mesh, user, traced=False)
            return
        if traced and self._ray_users.release(device_mesh, user) and device_mesh in self.blases:
            del self.blases[device_mesh]
            self.structures.drop(device_mesh)
        if self.rows.release(device_mesh, user):
            self._remove_mesh(device_mesh)

    def _remove_posed(self, device_mesh: PosedMesh) -> None:
        self.posed.remove(device_mesh)
        if self.blases.pop(device_mesh, None) is not None:
            self.structures.all_alive = False
        for of_meshes in (self.centers, self.half_sizes, self.orders):
            of_meshes.pop(device_mesh, None)
        self._posed_meshes.pop((device_mesh.mesh, device_mesh.instance), None)

    def _remove_mesh(self, mesh: Mesh) -> None:
        mesh.unwatch(self._watcher)
        self._to_upload.pop(mesh, None)
        self._no_duplicate_any_hit.discard(mesh)
        if mesh not in self._buffers:  # it was never uploaded
            return
        buffer = self._buffers.pop(mesh)
        if self._contents.release(self._content_of.pop(mesh), mesh):
            buffer.destroy()
        self.posed.forget(mesh)
        self._uploaded.pop(mesh, None)
        self.structures.forget_tensors(mesh)
        del self.centers[mesh], self.half_sizes[mesh], self.orders[mesh]

    def mark_changed(self, mesh: Mesh) -> list[Any]:
        """Have `update` upload a mesh again that was edited; returns the instances that use it."""
        if mesh not in self.rows:
            return []
        self._to_upload[mesh] = None
        if self.posed.free_poses_of(mesh):
            self.structures.all_alive = False
        return self.rows.users(mesh)

    def use_no_duplicate_any_hit(self, mesh: Mesh) -> bool:
        """Have `update` build the acceleration structure of a blended mesh so that no ray meets a triangle twice.
        Returns whether it is another one then."""
        if mesh in self._no_duplicate_any_hit:
            return False
        self._no_duplicate_any_hit.add(mesh)
        self.mark_changed(mesh)
        return True

    def update(self, revision: int) -> list[Any]:
        """Upload new and changed meshes and build their acceleration structures, and write the records of new poses.

        revision: of the scene. Returns the instances that have other acceleration structures now.
        """
        self.table.reserve(self.rows.high_water_mark)
        users = self._update_meshes(revision) if self._to_upload else []
        for device_mesh in self.posed.update(revision, self.rows.__getitem__, self._packed):
            record = self.table.records[self.rows[device_mesh]]
            self._set_bounds(device_mesh, record["bounds_min"], record["bounds_max"])
            self.orders[device_mesh] = self.orders[device_mesh.mesh]
            if device_mesh.blases:
                self.blases[device_mesh] = device_mesh.blases[device_mesh.side]
                users.append(device_mesh.instance)
        return users

    def accept_tensors(self, mesh: Mesh, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """Tensors of a mesh's vertices, in the device's memory; None for what the host must read: of meshes that are
        new, that deform, or that have no normals."""
        if mesh not in self._uploaded or mesh.deformation is not None:
            return None
        if "normals" in fields and mesh._stored("normals") is None:
            return None
        return self.tensors.accept(mesh, fields)

    def box(self, device_mesh: DeviceMesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The center and half the size of a mesh's bounds, which of vertices in tensors are read by the host."""
        if device_mesh in self.tensors:
            assert isinstance(device_mesh, Mesh)
            self._set_bounds(device_mesh, *_bounds(device_mesh.positions[device_mesh.triangles]))
        return self.centers[device_mesh], self.half_sizes[device_mesh]

    def _update_meshes(self, revision: int) -> list[Any]:
        geometries: dict[Mesh, TriangleGeometry] = {}
        try:
            with self._device.uploads() as uploads:
                for mesh in self._to_upload:
                    geometries[mesh] = self._upload(mesh, uploads, revision)
        # Nothing that was staged is on the device.
        except BaseException:
            for mesh in geometries:
                del self._uploaded[mesh]
            raise
        traced = {mesh: geometry for mesh, geometry in geometries.items() if mesh in self._ray_users}
        builds = {
            mesh: (self._content_of[mesh], mesh in self._no_duplicate_any_hit)
            for mesh in traced
            if mesh not in self.tensors
        }
        self.blases |= self.structures.build(traced, builds, self._moved)
        self._to_upload = {}
        self._moved = set()
        return [user for mesh in traced for user in self._ray_users.users(mesh)]

    def _upload(self, mesh: Mesh, uploads: Uploads, revision: int) -> TriangleGeometry:
        """Have a mesh on the device: in memory of its own, or in that of an equal one."""
        self._features.add_of(mesh)
        now = {name: mesh._stored(name) for name in (*ARRAYS, "tangent_frame")}
        before = self._uploaded.get(mesh)
        if before is None or before["positions"] is not now["positions"]:
            self._moved.add(mesh)
        if before is None or not self.tensors.gave_all_changes(before, now):
            self._upload_from_host(mesh, uploads, revision)
        else:
            tensors = {name: value for name, value in now.items() if value is not before[name]}
            if tensors:
                self._write_tensors(mesh, tensors, revision)
        self._uploaded[mesh] = now
        self.table.mark([self.rows[mesh]])
        record = self.table.records[self.rows[mesh]]
        # What the device has, and what poses make, isn't known here.
        if isinstance(now["normals"], DeviceTensor) or (mesh.deformation is not None and now["normals"] is not None):
            record["flags"] |= MESH_SMOOTH_NORMALS
        if record["flags"] & MESH_SMOOTH_NORMALS:
            self._features.add(SMOOTH_NORMALS)
        has_tensors = mesh in self.tensors
        return TriangleGeometry(
            positions=int(record["positions"]),
            position_count=mesh._stored("positions").shape[0],
            indices=int(record["triangles"]),
            triangle_count=int(record["triangle_count"]),
            # Structures that are refitted allow it, and may be a blended mesh's later.
            no_duplicate_any_hit=has_tensors or mesh in self._no_duplicate_any_hit,
        )

    def _upload_from_host(self, mesh: Mesh, uploads: Uploads, revision: int) -> None:
        # What was edited is not compared, so that edits take no time for that.
        is_edited = mesh in self._buffers
        content: Hashable = (
            object()
            if is_edited
            else content_of(*(getattr(mesh, name) for name in ARRAYS), np.array(mesh.tangent_frame))
        )
        equal = self._contents.users(content)
        if equal:
            self._share(mesh, content, equal[0])
        else:
            self._upload_new(mesh, content, uploads, revision)
        self.structures.forget_tensors(mesh)

    def _write_tensors(self, mesh: Mesh, tensors: dict[str, DeviceTensor], revision: int) -> None:
        """Have a mesh in memory of its own, which is a copy of the earlier one but for the vertices in tensors."""
        target = self.tensors.write(mesh, self._buffers[mesh], tensors)
        self._replace_buffer(mesh, object(), target, revision, self.posed.is_seen and "positions" in tensors)

    def _set_buffer(self, mesh: Mesh, content: Hashable, buffer: Buffer) -> None:
        self._contents.acquire(content, mesh)
        self._buffers[mesh] = buffer
        self._content_of[mesh] = content

    def _share(self, mesh: Mesh, content: Hashable, equal: Mesh) -> None:
        self._set_buffer(mesh, content, self._buffers[equal])
        self.orders[mesh] = self.orders[equal]
        self.centers[mesh] = self.centers[equal]
        self.half_sizes[mesh] = self.half_sizes[equal]
        records = self.table.records
        # Edited meshes are equal to none, so that this record names no earlier positions.
        records[self.rows[mesh]] = records[self.rows[equal]]

    def _upload_new(self, mesh: Mesh, content: Hashable, uploads: Uploads, revision: int) -> None:
        """Upload a mesh as one buffer: positions, triangles in spatial order, and other attributes if there are any."""
        corners = mesh.positions[mesh.triangles]
        order = memory_order(self._device.properties.kind, corners.min(axis=1), corners.max(axis=1))
        self.orders[mesh] = order
        low, high = _bounds(corners)
        self._set_bounds(mesh, low, high)
        flags, parts = mesh_parts(mesh, mesh.triangles[order], self._attributes)
        buffer = self._device.buffer(sum(part.nbytes for part in parts.values()), mesh.name or "mesh")
        self._replace_buffer(mesh, content, buffer, revision, self._moves(mesh))
        addresses = dict.fromkeys(ADDRESSES, 0)
        offset = 0
        for name, part in parts.items():
            addresses[name] = buffer.address + offset
            uploads.buffer(buffer, part, offset)
            offset += part.nbytes
        record = self.table.records[self.rows[mesh]]
        for name, address in addresses.items():
            record[name] = address
        record["previous_positions"] = record["positions"]
        record["triangle_count"] = len(order)
        record["vertex_count"] = len(mesh.positions)
        record["more_uv_sets"] = mesh.uv_set_count - 1
        record["tangent_frame"] = mesh.tangent_frame
        record["flags"] = flags
        record["bounds_min"] = low
        record["bounds_max"] = high

    def _set_bounds(self, device_mesh: DeviceMesh, low: Any, high: Any) -> None:
        self.centers[device_mesh] = (low + high) / 2
        self.half_sizes[device_mesh] = (high - low) / 2

    def _packed(self, mesh: Mesh) -> NDArray[Any] | None:
        return pack_attributes(mesh, self._attributes)[1]

    def _moves(self, mesh: Mesh) -> bool:
        """Whether the vertices of an edited mesh move, as far as is known and somebody has seen them."""
        before = self._uploaded.get(mesh)
        if not self.posed.is_seen or before is None or not np.array_equal(before["triangles"], mesh.triangles):
            return False
        positions = before["positions"]
        if isinstance(positions, DeviceTensor):
            return positions.shape == mesh.positions.shape
        return len(positions) == len(mesh.positions) and not np.array_equal(positions, mesh.positions)

    def _replace_buffer(self, mesh: Mesh, content: Hashable, buffer: Buffer, revision: int, moves: bool) -> None:
        """Have a mesh in a new buffer, which begins with the positions. The earlier buffer stays for motion vectors, or
        is freed. moves: the mesh has other positions of the same triangles."""
        before = self._buffers.get(mesh)
        self._uploaded.pop(mesh, None)
        is_last_user = before is not None and self._contents.release(self._content_of[mesh], mesh)
        self._set_buffer(mesh, content, buffer)
        if before is None:
            return
        if moves:
            if not is_last_user:  # an equal mesh goes on to use it
                before = copy_of_positions(self._device, before, mesh._stored("positions").shape[0])
            self.posed.edit(mesh, self.rows[mesh], before, buffer.address, revision)
            # Shaders read previous positions of vertices only with this feature.
            self._features.add("SCENE_POSES")
            return
        self.posed.forget(mesh)
        if is_last_user:
            before.destroy()

    def destroy(self) -> None:
        self.moved_trees.destroy()
        self.posed.destroy()
        self.tensors.destroy()
        self.structures.destroy()
        for buffer in set(self._buffers.values()):
            buffer.destroy()
        self.table.destroy()
        for device_mesh in self.rows:
            if isinstance(device_mesh, Mesh):
                device_mesh.unwatch(self._watcher)


def _bounds(corners: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The min and the max (3,) of the corners (M, 3, 3) of triangles."""
    return corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
