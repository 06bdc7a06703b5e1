"""Computes poses of meshes by scene/deform.comp, and refits or builds their BLASes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.structure import clock, make_scratch, scratch_size
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.storage import Storage
from solari_vk.gpu.frame.kernel import Kernel
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.scene.constants import MESH_HAS_NORMALS, MESH_HAS_TANGENTS, NO_INDEX
from solari_vk.scene.deformation import Deformation
from solari_vk.scene.matrices import by_columns
from solari_vk.scene.objects import Instance, Mesh
from solari_vk.scene.table import Table

MAX_REFITS = 32
MAX_GROWTH = 1.5
"""A BLAS is built anew when the surface area of the bounds has changed by this factor since the last build."""
TIMED = ("vertices", "structures")
"""The parts of the device's work that `Poser.stopwatch` times."""
MAX_GROUPS = 65535  # in one dimension of a dispatch, on any device

Pose = tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]


class PosedMesh:
    """A mesh in the pose of an instance."""

    def __init__(self, mesh: Mesh, instance: Instance) -> None:
        self.mesh = mesh
        self.instance = instance
        self.pose: Pose = (None, None)
        """What its vertices are to show."""
        self.side = 0
        """Which of the two positions and BLASes show the pose."""
        self.revisions = [-1, -1]
        """The revisions of the scene from which on the two poses are current; -1 for none."""
        self.copies: dict[int, Buffer] = {}
        """Positions of earlier poses by their revisions."""
        self.buffer: Buffer | None = None
        self.addresses = (0, 0, 0)  # two of positions, and of attributes
        self.blases: list[Blas] = []
        self.refits = 0
        self.built_area = 0.0
        self.area = 0.0
        self.work: dict[tuple[int, ...], Any] = {}
        """Records of work for `Poser`, by what they depend on."""
        self.build_infos: dict[tuple[int, bool], raw.CData] = {}
        """What the device is told of builds, by side and whether they are refits."""

    @property
    def deformation(self) -> Deformation:
        """The deformation of its mesh."""
        assert self.mesh.deformation is not None
        return self.mesh.deformation

    @property
    def rebuilds(self) -> bool:
        """Whether its BLAS should be built rather than refitted."""
        growth = self.area / self.built_area if self.built_area > 0 else 2 * MAX_GROWTH
        return self.refits >= MAX_REFITS or not 1 / MAX_GROWTH <= growth <= MAX_GROWTH

    def revision_at(self, revision: float) -> int:
        """The revision of the latest known pose that is not newer than a revision; -1 if there is none."""
        return max((known for known in (*self.revisions, *self.copies) if known <= revision), default=-1)

    def address_at(self, revision: float) -> int | None:
        """The address of the positions at a revision, None if they aren't known."""
        found = self.revision_at(revision)
        if found in self.copies:
            return self.copies[found].address
        return self.addresses[self.revisions.index(found)] if found >= 0 else None

    def destroy(self) -> None:
        """Free its memory; it can be made again."""
        for owned in (self.buffer, *self.blases, *self.copies.values()):
            if owned is not None:
                owned.destroy()
        self.buffer, self.blases, self.built_area, self.copies = None, [], 0.0, {}
        self.work, self.build_infos = {}, {}

    def build_info(self, scratch: int, *, update: bool) -> raw.CData:
        """What the device is told of a build of the current side, or of its refit from the other one."""
        info = self.build_infos.get((self.side, update))
        if info is None:
            info = self.blases[self.side].build_info(update=update, source=self.blases[1 - self.side])
            self.build_infos[self.side, update] = info
        info.scratchData.deviceAddress = scratch
        return info


class Poser:
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
            record["first_joint"], record["first_target"] = first_joint, first_target
            record["target_count"] = len(active)
            if matrices is None:
                record["influence_count"] = 0
            else:
                end = first_joint + len(matrices)
                self._joints.records["object_from_bind"][first_joint:end] = by_columns(matrices)
                first_joint = end
            if weights is not None:
                targets = self._targets.records[first_target : first_target + len(active)]
                targets["target"], targets["weight"] = active, weights[active]
                first_target += len(active)
        for table, count in zip(self.tables, (len(work), first_joint, first_target), strict=True):
            table.mark(range(count))

    def _addresses(self, shape: PosedMesh, base: Any, source: int) -> Any:
        """A record of what follows from the mesh and the side. source: the address of influences and targets."""
        key = shape.side, source, *base[["positions", "attributes", "flags"]].tolist()
        if key in shape.work:
            return shape.work[key]
        record = shape.work[key] = np.zeros((), self._work.records.dtype)
        deformation, floats = shape.deformation, self._attributes.itemsize // 4
        influences = 0 if deformation.joints is None else deformation.joints.size
        parts = [deformation.targets, deformation.target_normals, deformation.target_tangents]
        before = np.cumsum([0] + [3 * (part is not None) for part in parts]).tolist()
        flags, fields = int(base["flags"]), self._attributes.fields
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
            "target_width": before[3],
            "target_normal": before[1] if parts[1] is not None else 0,
            "target_tangent": before[2] if parts[2] is not None else 0,
            "attribute_width": floats,
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
                commands, (vertices, min(len(shapes) - first, MAX_GROUPS)), meshes=self._work.buffer.address,
                joints=self._joints.buffer.address, targets=self._targets.buffer.address, first_mesh=first,
            )  # fmt: skip
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
