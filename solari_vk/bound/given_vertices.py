"""Vertices of meshes that tensors give on the device: positions, normals, bounds, and structures for rays."""

from __future__ import annotations

from collections.abc import Container, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.bound.given_numbers import GivenNumbers, is_takable, take
from solari_vk.bound.mesh_parts import ADDRESSES
from solari_vk.bound.table import Rows, Table
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import BlasBuild, submit_batch
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.acceleration.structure import UpdateMode, clock
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.scene.checks import LARGEST_COORDINATE
from solari_vk.scene.objects import Mesh

MAX_REFITS = 8  # fewer than of poses, since nothing tells how far the vertices moved
MAX_BOXES = 256
BOX = np.dtype(("<f4", (2, 3)))
CORNERS_OF_GROUP = 1024


class GivenMesh:
    """What a mesh with vertices of a tensor has for itself. Its structures alternate, as those of poses."""

    def __init__(self, boxes: Buffer) -> None:
        self.boxes = boxes
        """The first one is that around the mesh."""
        self.blases: list[Blas] = []
        self.side = self.refits = 0

    def drop_structures(self) -> None:
        """Free its structures."""
        for blas in self.blases:
            blas.destroy()
        self.blases.clear()


class GivenVertices(GivenNumbers):
    """The meshes of a scene that have vertices of tensors. rows: of meshes in the table, whose records have the bounds
    as their last fields. attributes: the layout of VertexAttributes."""

    def __init__(self, device: Device, table: Table, rows: Rows[Any], attributes: np.dtype[Any]) -> None:
        super().__init__(device, "", "vertex", "be finite, and positions lie within 1e18 m")
        self._table, self._rows, self._attributes = table, rows, attributes
        self._meshes: dict[Mesh, GivenMesh] = {}

    def __contains__(self, mesh: object) -> bool:
        return mesh in self._meshes

    def take(self, mesh: Mesh, fields: Mapping[str, Any]) -> dict[str, Taken] | None:
        """Tensors of as many positions and normals as a mesh has; None for what the host must read."""
        shape = mesh._held("positions").shape
        if any(not is_takable(self._device, value) or tuple(value.shape) != shape for value in fields.values()):
            return None
        found = {name: take(self._device, value) for name, value in fields.items()}
        taken = {name: given for name, given in found.items() if given is not None}
        return taken if len(taken) == len(found) else None

    def fits(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
        """Whether a mesh whose arrays were some now has others that tensors of this device gave."""
        new = {name: value for name, value in now.items() if value is not before[name]}
        return new.keys() <= set(Mesh._on_device) and all(
            isinstance(value, Taken) and value.device is self._device for value in new.values()
        )

    def write(self, mesh: Mesh, source: Buffer, given: Mapping[str, Taken]) -> Buffer:
        """Returns new memory of a mesh: a copy of the earlier one, with what tensors gave. The record of the mesh gets
        the new addresses, if nothing fails."""
        record = self._table.records[self._rows[mesh]].copy()
        with ExitStack() as undo:
            target = self._device.buffer(source.size, mesh.name or "mesh")
            undo.callback(target.destroy)
            for name in ADDRESSES:
                record[name] = int(record[name]) and int(record[name]) - source.address + target.address
            record["previous_positions"] = record["positions"]
            if mesh not in self._meshes:
                undo.callback(self.forget, mesh)
            self._write(mesh, record, source, target, given)
            undo.pop_all()
        self._table.records[self._rows[mesh]] = record
        return target

    def _write(self, mesh: Mesh, record: Any, source: Buffer, target: Buffer, given: Mapping[str, Taken]) -> None:
        corners = 3 * int(record["triangle_count"])
        boxes = min(-(-corners // CORNERS_OF_GROUP), MAX_BOXES)
        is_new = mesh not in self._meshes
        if is_new:
            self._meshes[mesh] = GivenMesh(self._device.buffer(MAX_BOXES * BOX.itemsize, "bounds of a given mesh"))
        fields = self._attributes.fields
        assert fields is not None
        places = {
            "positions": (int(record["positions"]), 3),
            "normals": (int(record["attributes"]) + fields["normal"][1], self._attributes.itemsize // 4),
        }
        steps = []
        for name, taken in given.items():
            target_address, step = places[name]
            pushed = {
                **self._source(taken, f"{mesh.describe()}: {name}"),
                "target": target_address,
                "step": step,
                "count": taken.shape[0],
                "largest": LARGEST_COORDINATE if name == "positions" else np.finfo(np.float32).max,
            }
            steps.append(("vertices", taken.shape[0], pushed))
        if is_new or "positions" in given:
            bounds = {
                "positions": int(record["positions"]),
                "corners": int(record["triangles"]),
                "boxes": self._meshes[mesh].boxes.address,
            }
            threads = 256 * boxes
            steps.append(("bounds", threads, {**bounds, "count": corners, "is_merging": 0}))
            steps.append(("bounds", 1, {**bounds, "count": boxes, "is_merging": 1}))
        kernels = {name: self._kernel(name) for name, _, _ in steps}
        vk = self._device.vk

        def record_all(commands: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            source.record_copy(commands, target.handle, size=source.size)
            for name, threads, pushed in steps:
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
                kernels[name].record(commands, (threads, 1), **pushed)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start(record_all, f"vertices of {mesh.name or 'mesh'}")

    def write_bounds(self) -> None:
        """Write the bounds of all meshes to the table, whose rows were uploaded."""
        if not self._meshes:
            return
        fields = self._table.records.dtype.fields
        assert fields is not None
        size, begin = self._table.records.dtype.itemsize, fields["bounds_min"][1]
        copies = [(given.boxes, self._rows[mesh] * size + begin) for mesh, given in self._meshes.items()]

        def record(commands: raw.CData) -> None:
            self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
            for boxes, place in copies:
                boxes.record_copy(commands, self._table.buffer.handle, size=BOX.itemsize, begin=place)
            self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())

        self._device.start_with_next(record, "bounds of given meshes")

    def structures(self, geometries: Mapping[Mesh, TriangleGeometry], moved: Container[Mesh]) -> dict[Mesh, Blas]:
        """The structures of meshes. moved: those that have other positions than at the latest call."""
        builds = [
            self._build(mesh, geometry)
            for mesh, geometry in geometries.items()
            if mesh in moved or not self._meshes[mesh].blases
        ]
        if builds:
            submit_batch(self._device, builds, clock.tick())
        return {mesh: self._meshes[mesh].blases[self._meshes[mesh].side] for mesh in geometries}

    def _build(self, mesh: Mesh, geometry: TriangleGeometry) -> BlasBuild:
        given = self._meshes[mesh]
        given.side = 1 - given.side if given.blases else 0
        if len(given.blases) == given.side:
            given.blases.append(
                Blas(
                    self._device,
                    [geometry],
                    allow_compaction=False,
                    name=mesh.name or "mesh",
                    update_mode=UpdateMode.PREFER_UPDATE,
                )
            )
        blas, other = given.blases[given.side], given.blases[given.side - 1]
        update = other is not blas and other.built and given.refits < MAX_REFITS
        blas.set_geometries([geometry])
        given.refits = given.refits + 1 if update else 0
        return BlasBuild(blas, update, other if update else None)

    def drop_structures(self, mesh: Mesh) -> bool:
        """Rays don't meet a mesh any more; returns whether structures were freed."""
        given = self._meshes.get(mesh)
        if given is None or not given.blases:
            return False
        given.drop_structures()
        return True

    def forget(self, mesh: Mesh) -> bool:
        """The host gives all vertices of a mesh again, or it isn't used; returns whether structures were freed."""
        freed = self.drop_structures(mesh)
        if given := self._meshes.pop(mesh, None):
            given.boxes.destroy()
        return freed

    def destroy(self) -> None:
        for mesh in list(self._meshes):
            self.forget(mesh)
        super().destroy()
