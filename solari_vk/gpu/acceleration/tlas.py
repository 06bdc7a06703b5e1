"""Top-level acceleration structures, over instances of bottom-level ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.acceleration.structure import BuildOptions, Structure, clock, make_scratch
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device

# VkAccelerationStructureInstanceKHR: twice a 24-bit number in the low bits with an 8-bit one above it.
INSTANCE_DTYPE = np.dtype(
    [
        ("transform", "<f4", (3, 4)),
        ("custom_index_and_mask", "<u4"),
        ("sbt_offset_and_flags", "<u4"),
        ("blas_address", "<u8"),
    ]
)


class Tlas(Structure):
    """A top-level structure over up to `max_instances` INSTANCE_DTYPE records in device memory.

    The constructor makes storage and scratch, so `handle` can be bound before the first build. An instance whose
    blas_address is 0 is never hit. options: those of `BuildOptions`. `blases` are the structures below it, which
    `check_usable` checks.
    """

    def __init__(self, device: Device, max_instances: int, *, name: str = "tlas", **options: Any) -> None:
        limit = int(device.properties.acceleration.maxInstanceCount)
        max_instances = whole_number(max_instances, f"Tlas {name}: max_instances")
        if not 0 <= max_instances <= limit:
            raise SolariError(f"Tlas {name} of {max_instances:,} instances: this device takes 0 to {limit:,}")
        self.max_instances = max_instances
        self.instance_count = 0
        self.blases: tuple[Blas, ...] = ()
        self.built_records = np.zeros(0, INSTANCE_DTYPE)
        self._checked_at = -1  # never: the clock of a fresh process stands at 0
        # The address of the instances is set by each build; the sizes need only their number.
        instances = raw.struct(
            "VkAccelerationStructureGeometryKHR",
            geometryType=raw.VK_GEOMETRY_TYPE_INSTANCES_KHR,
            geometry={"instances": raw.struct("VkAccelerationStructureGeometryInstancesDataKHR")},
        )
        kind = raw.VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR
        super().__init__(device, kind, BuildOptions(**options), [instances], [max_instances], name)
        with device.undone_on_error():
            self.create(self.size)
            scratch_bytes = max(self.build_scratch_size, self.update_scratch_size)
            self._scratch, self._scratch_address = make_scratch(device, scratch_bytes, f"{name} scratch")

    def record_build(
        self,
        cmd: raw.CData,
        instances: int,
        count: int,
        *,
        update: bool = False,
        blases: Iterable[Blas] = (),
        at: int | None = None,
    ) -> None:
        """Record a build over `count` records at a device address (16-byte aligned), with its barriers.

        It runs after everything before it and before everything after it. `update` refits after transforms changed; the
        count must be the same. `blases` are the structures that the records refer to, for `check_usable`. `at` is the
        time of the build call. Raises SolariError for arguments that are invalid in Vulkan.
        """
        self._record(cmd, instances, count, update=update)
        self._mark_built(count, clock.tick() if at is None else at, update=update, blases=blases)

    def _record(self, cmd: raw.CData, instances: int, count: int, *, update: bool = False) -> None:
        self.check_alive("build")
        if not 0 <= count <= self.max_instances:
            raise SolariError(
                f"build of Tlas {self.name}: {count:,} instances, but it was made for {self.max_instances:,}"
            )
        # Vulkan demands equal counts of a refit; transforms and references may change.
        if update:
            self.check_update()
            if count != self.instance_count:
                raise SolariError(
                    f"refit of Tlas {self.name}: {count:,} instances, but it was built with {self.instance_count:,}"
                )
        # Vulkan's alignment of arrays of instances.
        if count and (instances <= 0 or instances % 16):
            raise SolariError(
                f"build of Tlas {self.name}: the instances' address {instances:#x} is not a multiple of 16"
            )
        info = self._info(instances, count, update=update)
        vk = self.device.vk
        ranges = raw.array(
            "VkAccelerationStructureBuildRangeInfoKHR*",
            [raw.struct("VkAccelerationStructureBuildRangeInfoKHR", primitiveCount=count)],
        )
        # The records may have been written, and an earlier frame may trace the structure until now.
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBuildAccelerationStructuresKHR(cmd, 1, info, ranges)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    def _info(self, instances: int, count: int, *, update: bool = False) -> raw.CData:
        # Without instances there is no buffer, but the address must be valid all the same.
        self._geometries[0].geometry.instances.data.deviceAddress = instances if count else self._scratch_address & ~15
        return self.build_info(self._scratch_address, update=update)

    def _mark_built(self, count: int, at: int, *, update: bool = False, blases: Iterable[Blas] = ()) -> None:
        """Record a build over `count` records at this time."""
        self.instance_count = count
        self.blases = tuple(blases)
        self.built_records = self.built_records[:0]
        self.mark_built(at, update=update)

    def refits(self, records: NDArray[Any]) -> bool:
        """Whether a build call would refit it to these records: same count, same structures as in the latest build."""
        before = self.built_records["blas_address"]
        return self.prefers_update and np.array_equal(records["blas_address"], before)

    def check_usable(self) -> None:
        """Raise SolariError unless rays may be traced through it.

        It must have been built, and nothing below it may have been built or destroyed since. Checks again only after
        a build or a destruction.
        """
        if self._checked_at == clock.now:
            return
        self.check_alive("use")
        if not self.built:
            raise SolariError(f"use of {self.describe()}, which was never built")
        for blas in self.blases:
            if blas.destroyed:
                raise SolariError(f"use of {self.describe()}, built over {blas.describe()}, which was destroyed")
            if blas.built_at > self.built_at:
                raise SolariError(
                    f"use of {self.describe()}, built over {blas.describe()}, which was built again since: "
                    "build the Tlas again"
                )
        self._checked_at = clock.now

    def destroy(self) -> None:
        """Destroy it when the work submitted so far is done. Safe to call twice."""
        super().destroy()
        self._scratch.destroy()


class TlasBuild:
    """A build of a Tlas over the records at an address, recorded once and submitted whenever the records changed.

    Arguments and errors as for `Tlas.record_build`.
    """

    def __init__(self, tlas: Tlas, instances: int, count: int) -> None:
        self.made_for = tlas, instances, count
        self._tlas = tlas
        self._count = count
        self._commands = Recorded(tlas.device, lambda cmd: tlas._record(cmd, instances, count), "build tlas")

    def submit(self) -> None:
        """Have the build run just before the next submission. Raises SolariError if the Tlas was destroyed."""
        self._tlas.check_alive("build")
        self._commands.submit_with_next()
        self._tlas._mark_built(self._count, clock.tick())

    def destroy(self) -> None:
        """Free the commands when the work submitted so far is done. Safe to call twice."""
        self._commands.destroy()


class TlasBuilds:
    """Builds of many structures in one call, recorded once and submitted whenever the records changed.

    instances: the device address of the records, `stride` for each structure, one after the other, of which it has the
    first of these `counts`.
    """

    def __init__(self, structures: Sequence[Tlas], instances: int, stride: int, counts: Sequence[int]) -> None:
        self._structures, self._counts = structures, counts
        device = structures[0].device
        step = stride * INSTANCE_DTYPE.itemsize
        each = list(zip(structures, counts, strict=True))
        infos = [tlas._info(instances + index * step, count) for index, (tlas, count) in enumerate(each)]
        sizes = {
            count: raw.struct("VkAccelerationStructureBuildRangeInfoKHR", primitiveCount=count) for count in set(counts)
        }
        ranges = [sizes[count] for count in counts]
        arguments = (
            raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos),
            raw.array("VkAccelerationStructureBuildRangeInfoKHR*", ranges),
        )

        def record(cmd: raw.CData) -> None:
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            device.vk.vkCmdBuildAccelerationStructuresKHR(cmd, len(infos), *arguments)
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        self._commands = Recorded(device, record, "build tlases")

    def submit(self) -> None:
        """Have the builds run just before the next submission."""
        self._commands.submit_with_next()
        at = clock.tick()
        for tlas, count in zip(self._structures, self._counts, strict=True):
            if not tlas.built or tlas.instance_count != count:  # later builds are like the first
                tlas._mark_built(count, at)

    def destroy(self) -> None:
        """Free the commands when the work submitted so far is done. Safe to call twice."""
        self._commands.destroy()


class TlasCopy:
    """A copy of a Tlas to another one of the same size, recorded once and submitted as often as needed."""

    def __init__(self, source: Tlas, target: Tlas) -> None:
        self.made_for = source, target
        info = raw.struct(
            "VkCopyAccelerationStructureInfoKHR",
            src=source.handle,
            dst=target.handle,
            mode=raw.VK_COPY_ACCELERATION_STRUCTURE_MODE_CLONE_KHR,
        )
        vk = source.device.vk

        def record(cmd: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            vk.vkCmdCopyAccelerationStructureKHR(cmd, info)
            vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        self._commands = Recorded(source.device, record, "copy tlas")

    def submit(self) -> None:
        """Have the copy run just before the next submission. Raises SolariError if a Tlas was destroyed."""
        source, target = self.made_for
        source.check_usable()
        target.check_alive("copy")
        self._commands.submit_with_next()
        target._mark_built(source.instance_count, clock.tick(), blases=source.blases)

    def destroy(self) -> None:
        """Free the commands when the work submitted so far is done. Safe to call twice."""
        self._commands.destroy()
