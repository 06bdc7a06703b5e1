"""Computes poses of meshes by scene/deform.comp, and refits or builds their BLASes."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.bound.constants import MESH_HAS_NORMALS, MESH_HAS_TANGENTS, NO_INDEX
from solari_vk.bound.posed_mesh import PosedMesh
from solari_vk.bound.table import Table
from solari_vk.gpu.acceleration.structure import clock, make_scratch, scratch_size
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.storage import Storage
from solari_vk.gpu.frame.kernel import Kernel
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.scene.matrices import by_columns

# The parts of the device's work that `PoseCommands.stopwatch` times.
TIMED = ("vertices", "structures")
MAX_GROUPS = 65535  # in one dimension of a dispatch, on any device


class PoseCommands:
    """The records of work for the device. layout: the records of scene/posed.glsl, by name."""

    def __init__(self, device: Device, layout: dict[str, Any]) -> None:
        self._device = device
        self._work = Table(device, "posed meshes", layout["posed_meshes"])
        self._joints = Table(device, "joints", layout["joints"])
        self._targets = Table(device, "active targets", layout["active_targets"])
        self.tables = (self._work, self._joints, self._targets)
        """Are uploaded between `write` and `submit`."""
        self._influence = layout["influences"]
        self._attributes = layout["vertex_attributes"]
        self.stopwatch: Stopwatch | None = None
        self._kernel: Kernel | None = None
        self._scratch: tuple[Storage, int, int] | None = None  # with its address and size

    def write(self, work: list[tuple[PosedMesh, Any, Buffer]]) -> None:
        """Write the poses that `submit` computes, one after the other: shapes, the records of their meshes in the rest
        pose, and their influences and targets."""
        shapes = [shape for shape, _, _ in work]
        joints = [shape.pose[0] for shape in shapes if shape.pose[0] is not None]
        self._joints.reserve(sum(map(len, joints)))
        weighted = [np.flatnonzero(shape.pose[1]) if shape.pose[1] is not None else () for shape in shapes]
        self._targets.reserve(sum(map(len, weighted)))
        self._work.reserve(len(work))
        first_joint = first_target = 0
        for number, ((shape, base, source), active) in enumerate(zip(work, weighted, strict=True)):
            matrices, weights = shape.pose
            self._work.records[number] = self._addresses(shape, base, source.address)
            record = self._work.records[number]
            record["first_joint"] = first_joint
            record["first_target"] = first_target
            record["target_count"] = len(active)
            if matrices is None:
                record["influence_count"] = 0
            else:
                end = first_joint + len(matrices)
                self._joints.records["object_from_bind"][first_joint:end] = by_columns(matrices)
                first_joint = end
            if weights is not None:
                targets = self._targets.records[first_target : first_target + len(active)]
                targets["target"] = active
                targets["weight"] = weights[active]
                first_target += len(active)
        for table, count in zip(self.tables, (len(work), first_joint, first_target), strict=True):
            table.mark(range(count))

    def _addresses(self, shape: PosedMesh, base: Any, source: int) -> Any:
        """A record of what follows from the mesh and the side. source: the address of influences and targets."""
        key = shape.side, source, *base[["positions", "attributes", "flags"]].tolist()
        if key in shape.work:
            return shape.work[key]
        record = shape.work[key] = np.zeros((), self._work.records.dtype)
        deformation = shape.deformation
        influences = 0 if deformation.joints is None else deformation.joints.size
        # A target adds to each vertex 3 numbers for the position, the normal and the tangent, each if it has them.
        parts = [deformation.targets, deformation.target_normals, deformation.target_tangents]
        begins = np.cumsum([0] + [0 if part is None else 3 for part in parts]).tolist()
        flags = int(base["flags"])
        fields = self._attributes.fields
        assert fields is not None
        values = {
            "rest_positions": base["positions"],
            "rest_attributes": base["attributes"],
            "influences": source,
            "targets": source + influences * self._influence.itemsize,
            "positions": shape.addresses[shape.side],
            "attributes": shape.addresses[2],
            "vertex_count": len(shape.mesh.positions),
            "influence_count": 0 if deformation.joints is None else deformation.joints.shape[1],
            "target_width": begins[3],
            "target_normal": begins[1] if parts[1] is not None else 0,
            "target_tangent": begins[2] if parts[2] is not None else 0,
            "attribute_width": self._attributes.itemsize // 4,
            "normal": fields["normal"][1] // 4 if flags & MESH_HAS_NORMALS else NO_INDEX,
            "tangent": fields["tangent"][1] // 4 if flags & MESH_HAS_TANGENTS else NO_INDEX,
        }
        for field, value in values.items():
            record[field] = value
        return record

    def submit(self, shapes: list[PosedMesh]) -> None:
        """Compute the vertices of poses and bring their BLASes up to date, just before the next submission."""
        if self._kernel is None:
            self._kernel = Kernel(self._device, "scene/deform.comp")
        builds = [(shape, not shape.rebuilds) for shape in shapes if shape.blases]
        self._device.start_with_next(lambda commands: self._record(commands, shapes, builds), "pose meshes")
        at = clock.tick()
        for shape, update in builds:
            shape.blases[shape.side].note_build(at, update=update)
            shape.refits = shape.refits + 1 if update else 0
            if not update:
                shape.built_area = shape.area

    def _record(self, commands: raw.CData, shapes: list[PosedMesh], builds: list[tuple[PosedMesh, bool]]) -> None:
        vk = self._device.vk
        assert self._kernel is not None
        vk.vkCmdPipelineBarrier2(commands, full_barrier())
        if self.stopwatch is not None:
            self.stopwatch.begin(commands)
        vertices = max(len(shape.mesh.positions) for shape in shapes)
        for first in range(0, len(shapes), MAX_GROUPS):
            self._kernel.record(
                commands,
                (vertices, min(len(shapes) - first, MAX_GROUPS)),
                meshes=self._work.buffer.address,
                joints=self._joints.buffer.address,
                targets=self._targets.buffer.address,
                first_mesh=first,
            )
        vk.vkCmdPipelineBarrier2(commands, full_barrier())
        if self.stopwatch is not None:
            self.stopwatch.mark(commands, TIMED[0])
        if builds:
            self._record_builds(commands, builds)
        if self.stopwatch is not None:
            self.stopwatch.mark(commands, TIMED[1])

    def _record_builds(self, commands: raw.CData, builds: list[tuple[PosedMesh, bool]]) -> None:
        vk = self._device.vk
        sizes = [scratch_size(self._device, shape.blases[shape.side], update) for shape, update in builds]
        address = self._scratch_address(sum(sizes))
        infos = []
        for (shape, update), size in zip(builds, sizes, strict=True):
            infos.append(shape.build_info(address, update=update))
            address += size
        infos_array = raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos)
        ranges = [shape.blases[shape.side].ranges for shape, _ in builds]
        ranges_array = raw.array("VkAccelerationStructureBuildRangeInfoKHR*", ranges)
        vk.vkCmdBuildAccelerationStructuresKHR(commands, len(builds), infos_array, ranges_array)
        vk.vkCmdPipelineBarrier2(commands, full_barrier())

    def _scratch_address(self, size: int) -> int:
        if self._scratch is None or self._scratch[2] < size:
            if self._scratch is not None:
                self._scratch[0].destroy()
            storage, address = make_scratch(self._device, size, "scratch of poses")
            self._scratch = storage, address, size
        return self._scratch[1]

    def destroy(self) -> None:
        """Free everything."""
        scratch = None if self._scratch is None else self._scratch[0]
        for owned in (*self.tables, self._kernel, self.stopwatch, scratch):
            if owned is not None:
                owned.destroy()
