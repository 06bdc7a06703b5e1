"""Acceleration structures: bottom level (Blas) over geometry, top level (Tlas) over instances of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.barriers import full_barrier
from solari_vk.gpu.blas_builds import build_blases as build_blases
from solari_vk.gpu.geometry import AABB_DTYPE as AABB_DTYPE
from solari_vk.gpu.geometry import AabbGeometry as AabbGeometry
from solari_vk.gpu.geometry import Geometry as Geometry
from solari_vk.gpu.geometry import TriangleGeometry as TriangleGeometry
from solari_vk.gpu.geometry import check_geometries, geometry_struct
from solari_vk.gpu.structure import Structure, make_scratch

if TYPE_CHECKING:
    from solari_vk.gpu.device import Device

# VkAccelerationStructureInstanceKHR: a 24-bit number in the low bits and an 8-bit one above it, twice.
INSTANCE_DTYPE = np.dtype(
    [
        ("transform", "<f4", (3, 4)),
        ("custom_index_and_mask", "<u4"),
        ("sbt_offset_and_flags", "<u4"),
        ("blas_address", "<u8"),
    ]
)
_ALLOW_DATA_ACCESS = 0x800  # VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_DATA_ACCESS_KHR, newer than the package


class Blas(Structure):
    """A bottom-level structure over one or more geometries of one kind. It has an address once built.

    `size` is its storage in bytes, `built_size` what it was before compaction. The memory that geometries
    point to is needed while it builds, not later. Raises SolariError for geometry that can't be built.
    """

    def __init__(
        self,
        device: Device,
        geometries: Sequence[Geometry],
        *,
        prefer_fast_trace: bool = True,
        allow_update: bool = False,
        allow_compaction: bool = True,
        name: str = "blas",
    ) -> None:
        self.geometries = tuple(geometries)
        self.compacted = False
        check_geometries(device, self.geometries, name)
        flags = _preference(prefer_fast_trace)
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR * allow_update
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR * allow_compaction
        flags |= _ALLOW_DATA_ACCESS * device.has_position_fetch
        super().__init__(
            device,
            raw.VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
            flags,
            [geometry_struct(geometry) for geometry in self.geometries],
            [geometry.primitive_count for geometry in self.geometries],
            name,
        )
        self.built_size = self.size
        self.ranges = raw.array(
            "VkAccelerationStructureBuildRangeInfoKHR",
            [{"primitiveCount": geometry.primitive_count} for geometry in self.geometries],
        )

    @property
    def allow_compaction(self) -> bool:
        """Whether it can be compacted."""
        return bool(self.flags & raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR)


class Tlas(Structure):
    """A top-level structure over up to `max_instances` INSTANCE_DTYPE records in device memory.

    Storage and scratch are made at once, so `handle` can be bound before the first build. An instance whose
    blas_address is 0 is never hit.
    """

    def __init__(
        self,
        device: Device,
        max_instances: int,
        *,
        prefer_fast_trace: bool = True,
        allow_update: bool = False,
        name: str = "tlas",
    ) -> None:
        limit = int(device.properties.acceleration.maxInstanceCount)
        if not 0 <= max_instances <= limit:
            raise SolariError(f"Tlas {name} of {max_instances:,} instances: this device takes 0 to {limit:,}")
        self.max_instances = max_instances
        self.instance_count = 0
        instances = raw.struct(
            "VkAccelerationStructureGeometryKHR",
            geometryType=raw.VK_GEOMETRY_TYPE_INSTANCES_KHR,
            geometry={"instances": raw.struct("VkAccelerationStructureGeometryInstancesDataKHR")},
        )
        flags = _preference(prefer_fast_trace)
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR * allow_update
        flags |= _ALLOW_DATA_ACCESS * device.has_position_fetch
        kind = raw.VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR
        super().__init__(device, kind, flags, [instances], [max_instances], name)
        self._create(self.size)
        most = max(self.build_scratch_size, self.update_scratch_size)
        self._scratch, self._scratch_address = make_scratch(device, most, f"{name} scratch")

    def record_build(self, cmd: raw.CData, instances: int, count: int, *, update: bool = False) -> None:
        """Record a build over `count` records at a device address (16-byte aligned), with its barriers.

        It waits for everything before it, and everything after it waits for it. `update` refits after
        transforms changed, with the same count. Raises SolariError for what Vulkan would not survive.
        """
        self._check_alive("build")
        if not 0 <= count <= self.max_instances:
            raise SolariError(f"build of Tlas {self.name}: {count:,} instances, made for {self.max_instances:,}")
        if update:
            self._check_update()
            if count != self.instance_count:
                raise SolariError(
                    f"refit of Tlas {self.name}: {count:,} instances, but it was built with {self.instance_count:,}"
                )
        if count and (instances <= 0 or instances % 16):
            raise SolariError(f"build of Tlas {self.name}: instances at {instances:#x}, not a 16-byte aligned address")
        # No instances need no buffer, but the address must still be one.
        self._geometries[0].geometry.instances.data.deviceAddress = instances if count else self._scratch_address & ~15
        vk = self.device.vk
        ranges = raw.array(
            "VkAccelerationStructureBuildRangeInfoKHR*",
            [raw.struct("VkAccelerationStructureBuildRangeInfoKHR", primitiveCount=count)],
        )
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBuildAccelerationStructuresKHR(
            cmd, 1, self._build_info(self._scratch_address, update=update), ranges
        )
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        self.instance_count = count
        self.build_count += 1

    def destroy(self) -> None:
        """Destroy it when the work submitted so far is done. Safe to call twice."""
        super().destroy()
        self._scratch.destroy()


def _preference(fast_trace: bool) -> int:
    return int(
        raw.VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR
        if fast_trace
        else raw.VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_BUILD_BIT_KHR
    )
