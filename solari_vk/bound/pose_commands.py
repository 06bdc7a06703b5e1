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
from solari_vk.gpu.structures import traces_by_compute
from solari_vk.gpu.trees.refits import MovedTrees
from solari_vk.gpu.trees.tree import TreeBuilds
from solari_vk.scene.matrices import by_columns

# The parts of the device's work that `PoseCommands.stopwatch` times.
TIMED = ("vertices", "structures")
MAX_GROUPS = 65535  # in one dimension of a dispatch, on any device


class PoseCommands:
    """The records of work for the device. block_dtypes: the records of scene/posed.glsl, by name."""

    def __init__(self, device: Device, block_dtypes: dict[str, Any], moved_trees: MovedTrees) -> None:
        self._device = device
        self._moved_trees = moved_trees
        self._work = Table(device, "posed meshes", block_dtypes["posed_meshes"])
        self._joints = Table(device, "joints", block_dtypes["joints"])
        self._targets = Table(device, "active targets", block_dtypes["active_targets"])
        self.tables = (self._work, self._joints, self._targets)
        """Are uploaded between `write` and `submit`."""
        self._influence = block_dtypes["influences"]
        self._attributes = block_dtypes["vertex_attributes"]
        self.stopwatch: Stopwatch | None = None
        self._kernel: Kernel | None = None
        self._scratch: tuple[Storage, int, int] | None = None  # with its address and size
        self._tree_builds: list[TreeBuilds] = []

    def write(self, work: list[tuple[PosedMesh, Any, Buffer]]) -> None:
        """Write the poses that `submit` computes, one after the other: the posed meshes, their records at rest,
        and their influences and targets."""
        posed_meshes = [posed for posed, _, _ in work]
        joints = [posed.pose[0] for posed in posed_meshes if posed.pose[0] is not None]
        self._joints.reserve(sum(map(len, joints)))
        weighted = [np.flatnonzero(posed.pose[1]) if posed.pose[1] is not None else () for posed in posed_meshes]
        self._targets.reserve(sum(map(len, weighted)))
        self._work.reserve(len(work))
        first_joint = first_target = 0
        for number, ((posed, base, source), active) in enumerate(zip(work, weighted, strict=True)):
            matrices, weights = posed.pose
            self._work.records[number] = self._addresses(posed, base, source.address)
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

    def _addresses(self, posed: PosedMesh, base: Any, source: int) -> Any:
        """A record of what follows from the mesh and the side. source: the address of influences and targets."""
        key = posed.side, source, *base[["positions", "attributes", "flags"]].tolist()
        if key in posed.work:
            return posed.work[key]
        record = posed.work[key] = np.zeros((), self._work.records.dtype)
        deformation = posed.deformation
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
            "positions": posed.addresses[posed.side],
            "attributes": posed.addresses[2],
            "vertex_count": len(posed.mesh.positions),
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

    def submit(self, posed_meshes: list[PosedMesh]) -> None:
        """Compute the vertices of poses and bring their BLASes up to date, just before the next submission."""
        if self._kernel is None:
            self._kernel = Kernel(self._device, "scene/deform.comp")
        builds = [(posed, not posed.rebuilds) for posed in posed_meshes if posed.blases]
        self._device.start_with_next(lambda commands: self._record(commands, posed_meshes, builds), "pose meshes")
        # Their memory is free when what was recorded is done, which is known from here on.
        for tree_builds in self._tree_builds:
            tree_builds.destroy()
        self._tree_builds.clear()
        at = clock.tick()
        for posed, update in builds:
            if not traces_by_compute(self._device):
                posed.blases[posed.side].mark_built(at, update=update)
            posed.refits = posed.refits + 1 if update else 0
            if not update:
                posed.built_area = posed.area

    def _record(self, commands: raw.CData, posed_meshes: list[PosedMesh], builds: list[tuple[PosedMesh, bool]]) -> None:
        vk = self._device.vk
        assert self._kernel is not None
        vk.vkCmdPipelineBarrier2(commands, full_barrier())
        if self.stopwatch is not None:
            self.stopwatch.begin(commands)
        vertices = max(len(posed.mesh.positions) for posed in posed_meshes)
        for first in range(0, len(posed_meshes), MAX_GROUPS):
            self._kernel.record(
                commands,
                (vertices, min(len(posed_meshes) - first, MAX_GROUPS)),
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
        if traces_by_compute(self._device):
            self._record_trees(commands, builds)
            return
        sizes = [scratch_size(self._device, posed.blases[posed.side], update) for posed, update in builds]
        address = self._scratch_address(sum(sizes))
        infos = []
        for (posed, update), size in zip(builds, sizes, strict=True):
            infos.append(posed.build_info(address, update=update))
            address += size
        infos_array = raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos)
        ranges = [posed.blases[posed.side].ranges for posed, _ in builds]
        ranges_array = raw.array("VkAccelerationStructureBuildRangeInfoKHR*", ranges)
        vk.vkCmdBuildAccelerationStructuresKHR(commands, len(builds), infos_array, ranges_array)
        vk.vkCmdPipelineBarrier2(commands, full_barrier())

    def _record_trees(self, commands: raw.CData, poses: list[tuple[PosedMesh, bool]]) -> None:
        """Record builds of trees, and refits of each from the other side's."""
        built = [posed.blases[posed.side] for posed, update in poses if not update]
        fitted = [(posed.blases[posed.side], posed.blases[1 - posed.side]) for posed, update in poses if update]
        if built:
            builds = TreeBuilds(self._device, [(tree, tree.job) for tree in built])
            self._tree_builds.append(builds)
            builds.record(commands)
            builds.mark_built()
        if fitted:
            self._moved_trees.record(commands, fitted)

    def _scratch_address(self, size: int) -> int:
        if self._scratch is None or self._scratch[2] < size:
            if self._scratch is not None:
                self._scratch[0].destroy()
            storage, address = make_scratch(self._device, size, "scratch of poses")
            self._scratch = storage, address, size
        return self._scratch[1]

    def destroy(self) -> None:
        scratch = None if self._scratch is None else self._scratch[0]
        for owned in (*self.tables, self._kernel, self.stopwatch, scratch):
            if owned is not None:
                owned.destroy()
