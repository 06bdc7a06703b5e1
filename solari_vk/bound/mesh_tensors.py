"""Vertices that stay on the device as tensors: positions, normals, bounds, and acceleration structures."""

from __future__ import annotations

from collections.abc import Container, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.bound.mesh_parts import ADDRESSES
from solari_vk.bound.table import RowAllocator, Table
from solari_vk.gpu.acceleration.blas_builds import BlasBuild, submit_batch
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.acceleration.structure import clock
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.structures import MeshStructure, build_mesh_structures, mesh_structure, traces_by_compute
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import Dispatch, TensorPort, rule
from solari_vk.gpu.trees.refits import MovedTrees
from solari_vk.scene.checks import LARGEST_COORDINATE
from solari_vk.scene.objects import Mesh

MAX_REFITS = 8  # fewer than of poses, since nothing tells how far the vertices moved
MAX_BOXES = 256
BOX = np.dtype(("<f4", (2, 3)))
CORNERS_OF_GROUP = 1024


class TensorMesh:
    """What a mesh with vertices in tensors has for itself. Its structures alternate, as those of poses."""

    def __init__(self, boxes: Buffer) -> None:
        self.boxes = boxes
        """The first one is that around the mesh."""
        self.blases: list[Any] = []
        self.side = self.refits = 0

    def drop_structures(self) -> None:
        """Free its structures."""
        for blas in self.blases:
            blas.destroy()
        self.blases.clear()


class MeshTensors:
    """The meshes of a scene that have vertices in tensors. rows: of meshes in the table, whose records have the bounds
    as their last fields. attributes: the layout of VertexAttributes."""

    def __init__(
        self,
        device: Device,
        port: TensorPort,
        table: Table,
        rows: RowAllocator[Any],
        attributes: np.dtype[Any],
        moved_trees: MovedTrees,
    ) -> None:
        self._device = device
        self._port = port
        self._table = table
        self._rows = rows
        self._attributes = attributes
        self._moved_trees = moved_trees
        self._meshes: dict[Mesh, TensorMesh] = {}

    def __contains__(self, mesh: object) -> bool:
        return mesh in self._meshes

    def accept(self, mesh: Mesh, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """Tensors of as many positions and normals as a mesh has; None for what the host must read."""
        shape = mesh._stored("positions").shape
        return self._port.accept_fields(fields, lambda _: (shape,))

    def gave_all_changes(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
        """Whether all arrays of a mesh that are others than before are tensors of this device."""
        changed = {name: value for name, value in now.items() if value is not before[name]}
        return changed.keys() <= set(Mesh._tensor_fields) and all(map(self._port.owns, changed.values()))

    def write(self, mesh: Mesh, source: Buffer, tensors: Mapping[str, DeviceTensor]) -> Buffer:
        """Returns new memory of a mesh: a copy of the earlier one, with the vertices in tensors. The record of the mesh
        gets the new addresses, if nothing fails."""
        record = self._table.records[self._rows[mesh]].copy()
        with ExitStack() as undo:
            target = self._device.buffer(source.size, mesh.name or "mesh")
            undo.callback(target.destroy)
            for name in ADDRESSES:
                record[name] = int(record[name]) and int(record[name]) - source.address + target.address
            record["previous_positions"] = record["positions"]
            if mesh not in self._meshes:
                undo.callback(self.forget, mesh)
            self._write(mesh, record, source, target, tensors)
            undo.pop_all()
        self._table.records[self._rows[mesh]] = record
        return target

    def _write(
        self, mesh: Mesh, record: Any, source: Buffer, target: Buffer, tensors: Mapping[str, DeviceTensor]
    ) -> None:
        corners = 3 * int(record["triangle_count"])
        boxes = min(-(-corners // CORNERS_OF_GROUP), MAX_BOXES)
        is_new = mesh not in self._meshes
        if is_new:
            self._meshes[mesh] = TensorMesh(self._device.buffer(MAX_BOXES * BOX.itemsize, "bounds of a mesh"))
        fields = self._attributes.fields
        assert fields is not None
        places = {
            "positions": (int(record["positions"]), 3),
            "normals": (int(record["attributes"]) + fields["normal"][1], self._attributes.itemsize // 4),
        }
        dispatches = []
        for name, tensor in tensors.items():
            target_address, step = places[name]
            field = f"{mesh.describe()}: {name}"
            pushed = {
                **self._port.source(tensor),
                **self._port.refusal(field, rule(field, "vertex", "be finite, and positions lie within 1e18 m")),
                "target": target_address,
                "step": step,
                "count": tensor.shape[0],
                "largest": LARGEST_COORDINATE if name == "positions" else np.finfo(np.float32).max,
            }
            dispatches.append(Dispatch("vertices", (tensor.shape[0], 1), pushed))
        if is_new or "positions" in tensors:
            # A reduction in two steps: each group finds the box around its corners, then one group that around these.
            bounds = {
                "positions": int(record["positions"]),
                "corners": int(record["triangles"]),
                "boxes": self._meshes[mesh].boxes.address,
            }
            dispatches.append(Dispatch("bounds", (256 * boxes, 1), {**bounds, "count": corners, "is_merging": 0}))
            dispatches.append(Dispatch("bounds", (1, 1), {**bounds, "count": boxes, "is_merging": 1}))

        def copy_mesh(commands: raw.CData) -> None:
            source.record_copy(commands, target.handle, size=source.size)

        self._port.write(dispatches, f"vertices of {mesh.name or 'mesh'}", before=copy_mesh)

    def write_bounds(self) -> None:
        """Write the bounds of all meshes to the table, whose rows were uploaded."""
        if not self._meshes:
            return
        fields = self._table.records.dtype.fields
        assert fields is not None
        size, begin = self._table.records.dtype.itemsize, fields["bounds_min"][1]
        copies = [(own.boxes, self._rows[mesh] * size + begin) for mesh, own in self._meshes.items()]

        def record(commands: raw.CData) -> None:
            self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
            for boxes, place in copies:
                boxes.record_copy(commands, self._table.buffer.handle, size=BOX.itemsize, begin=place)
            self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())

        self._device.start_with_next(record, "bounds of meshes with tensors")

    def structures(
        self, geometries: Mapping[Mesh, TriangleGeometry], moved: Container[Mesh]
    ) -> dict[Mesh, MeshStructure]:
        """The structures of meshes. moved: those that have other positions than at the latest call."""
        builds = []
        for mesh, geometry in geometries.items():
            own = self._meshes[mesh]
            if mesh in moved or not own.blases:
                builds.append(self._build(mesh, geometry))
            else:  # its memory may be another one, which `MovedTrees` may read
                own.blases[own.side].set_geometries([geometry])
        if builds and traces_by_compute(self._device):
            build_mesh_structures(self._device, [build.blas for build in builds if not build.update])
            moved_trees: list[Any] = [(build.blas, build.source) for build in builds if build.update]
            self._moved_trees.submit(moved_trees)
        elif builds:
            submit_batch(self._device, builds, clock.tick())
        return {mesh: self._meshes[mesh].blases[self._meshes[mesh].side] for mesh in geometries}

    def _build(self, mesh: Mesh, geometry: TriangleGeometry) -> BlasBuild:
        """The build of the structure that rays meet next. The other one is still that of the frame before, from which
        this one is refitted, unless that has been done too often."""
        own = self._meshes[mesh]
        own.side = 1 - own.side if own.blases else 0
        if len(own.blases) == own.side:
            own.blases.append(mesh_structure(self._device, geometry, mesh.name or "mesh", moves=True))
        blas, other = own.blases[own.side], own.blases[own.side - 1]
        is_tree = traces_by_compute(self._device)  # of which `MovedTrees` knows how good they are
        update = other is not blas and other.built and (is_tree or own.refits < MAX_REFITS)
        blas.set_geometries([geometry])
        own.refits = own.refits + 1 if update else 0
        return BlasBuild(blas, update, other if update else None)

    def drop_structures(self, mesh: Mesh) -> bool:
        """Rays don't meet a mesh any more; returns whether structures were freed."""
        own = self._meshes.get(mesh)
        if own is None or not own.blases:
            return False
        own.drop_structures()
        return True

    def forget(self, mesh: Mesh) -> bool:
        """The host has all vertices of a mesh again, or it isn't used; returns whether structures were freed."""
        freed = self.drop_structures(mesh)
        own = self._meshes.pop(mesh, None)
        if own is not None:
            own.boxes.destroy()
        return freed

    def destroy(self) -> None:
        for mesh in list(self._meshes):
            self.forget(mesh)
