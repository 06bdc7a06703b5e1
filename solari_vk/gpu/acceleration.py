"""Acceleration structures: bottom level (Blas) over geometry, top level (Tlas) over instances of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.barriers import full_barrier
from solari_vk.gpu.memory import Buffer

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
AABB_DTYPE = np.dtype([("minimum", "<f4", 3), ("maximum", "<f4", 3)])
SCRATCH_BUDGET = 256 << 20
_STORAGE_USAGE = (
    raw.VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR | raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
)
_ALLOW_DATA_ACCESS = 0x800  # VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_DATA_ACCESS_KHR, newer than the package
_INDEX_TYPES = {
    np.dtype(np.uint16): raw.VK_INDEX_TYPE_UINT16,
    np.dtype(np.uint32): raw.VK_INDEX_TYPE_UINT32,
}


@dataclass(frozen=True)
class TriangleGeometry:
    """Triangles in device memory, all fields addresses in bytes or counts.

    positions: float32 x, y, z every `position_stride` bytes. indices: three a triangle of `index_dtype`
    (uint16 or uint32), or 0 when every three positions are a triangle. transform: 3x4 float32, row-major,
    16-byte aligned, or 0.
    """

    positions: int
    position_count: int
    triangle_count: int
    indices: int = 0
    index_dtype: type[np.unsignedinteger] = np.uint32
    position_stride: int = 12
    transform: int = 0
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    @property
    def primitive_count(self) -> int:
        """Number of triangles."""
        return self.triangle_count


@dataclass(frozen=True)
class AabbGeometry:
    """Boxes in device memory: AABB_DTYPE records at an address, `stride` bytes apart (a multiple of 8)."""

    boxes: int
    count: int
    stride: int = AABB_DTYPE.itemsize
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    @property
    def primitive_count(self) -> int:
        """Number of boxes."""
        return self.count


Geometry = TriangleGeometry | AabbGeometry


class _Structure:
    """What Blas and Tlas share: sizes, storage, handle and build commands."""

    def __init__(
        self, device: Device, kind: int, flags: int, geometries: Sequence[raw.CData], counts: list[int], name: str
    ) -> None:
        self.device = device
        self.name = name
        self.flags = flags
        self.handle: raw.CData | None = None
        self.address = 0
        self.build_count = 0
        self.destroyed = False
        self._kind = kind
        self._geometries = raw.array("VkAccelerationStructureGeometryKHR", geometries)
        self._geometry_count = len(geometries)
        sizes = raw.struct("VkAccelerationStructureBuildSizesInfoKHR")
        device.vk.vkGetAccelerationStructureBuildSizesKHR(
            device.handle,
            raw.VK_ACCELERATION_STRUCTURE_BUILD_TYPE_DEVICE_KHR,
            self._build_info(),
            raw.ffi.new("uint32_t[]", counts),
            sizes,
        )
        self.size = int(sizes.accelerationStructureSize)
        self.build_scratch_size = int(sizes.buildScratchSize)
        self.update_scratch_size = int(sizes.updateScratchSize)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.size:,} bytes, built {self.build_count} times>"

    @property
    def built(self) -> bool:
        """Whether a build was recorded or submitted."""
        return self.build_count > 0

    @property
    def allow_update(self) -> bool:
        """Whether it can be refitted."""
        return bool(self.flags & raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR)

    def _create(self, size: int) -> None:
        """Make storage, handle and address; the build comes later."""
        device = self.device
        self._storage = Buffer(device, size, f"{self.name} storage", usage=_STORAGE_USAGE)
        create = raw.struct(
            "VkAccelerationStructureCreateInfoKHR", buffer=self._storage.handle, size=size, type=self._kind
        )
        self.handle = handle = device.create("VkAccelerationStructureKHR", create, self.name)
        self._token = device.own(lambda: device.vk.vkDestroyAccelerationStructureKHR(device.handle, handle, raw.NULL))
        info = raw.struct("VkAccelerationStructureDeviceAddressInfoKHR", accelerationStructure=handle)
        self.address = int(device.vk.vkGetAccelerationStructureDeviceAddressKHR(device.handle, info))
        self.size = size

    def _build_info(self, scratch: int = 0, *, update: bool = False) -> raw.CData:
        build = raw.VK_BUILD_ACCELERATION_STRUCTURE_MODE_BUILD_KHR
        refit = raw.VK_BUILD_ACCELERATION_STRUCTURE_MODE_UPDATE_KHR
        return raw.struct(
            "VkAccelerationStructureBuildGeometryInfoKHR",
            type=self._kind,
            flags=self.flags,
            mode=refit if update else build,
            srcAccelerationStructure=self.handle if update else None,
            dstAccelerationStructure=self.handle,
            geometryCount=self._geometry_count,
            pGeometries=self._geometries,
            scratchData={"deviceAddress": scratch},
        )

    def _check_alive(self, action: str) -> None:
        if self.destroyed:
            raise SolariError(f"{action} of {type(self).__name__} {self.name}, which was destroyed")

    def _check_update(self) -> None:
        if not self.allow_update or not self.built:
            why = "it was made without allow_update" if not self.allow_update else "it was never built"
            raise SolariError(f"refit of {type(self).__name__} {self.name}: {why}")

    def destroy(self) -> None:
        """Destroy it when the work submitted so far is done. Safe to call twice."""
        self.destroyed = True
        if self.handle is not None:
            self.device.release(self._token)
            self._storage.destroy()
            self.handle = None
            self.address = 0


class Blas(_Structure):
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
        _check_geometries(device, self.geometries, name)
        flags = _preference(prefer_fast_trace)
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR * allow_update
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR * allow_compaction
        flags |= _ALLOW_DATA_ACCESS * device.has_position_fetch
        super().__init__(
            device,
            raw.VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
            flags,
            [_geometry(geometry) for geometry in self.geometries],
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


def build_blases(
    device: Device,
    blases: Sequence[Blas],
    *,
    compact: bool = True,
    update: bool = False,
    scratch_budget: int = SCRATCH_BUDGET,
) -> None:
    """Build structures in as few batches as the scratch budget (bytes) allows, and compact them.

    Batches overlap nothing else that is submitted. With `compact`, waits for each batch, so that at most
    one batch is held uncompacted; their addresses are final when this returns. `update` refits structures
    that were built with allow_update. Raises SolariError for one that was destroyed, or compacted before.
    """
    for blas in blases:
        blas._check_alive("build")
        if blas.compacted:
            raise SolariError(f"build of Blas {blas.name}, which was compacted: make a new one")
        if update:
            blas._check_update()
    if len(set(map(id, blases))) != len(blases):
        raise SolariError("the same Blas twice in one build")
    for batch in _batches(device, blases, scratch_budget, update):
        _build_batch(device, batch, update)
        shrinking = [blas for blas in batch if compact and blas.allow_compaction and not update]
        if shrinking:
            _compact(device, shrinking)


def _batches(device: Device, blases: Sequence[Blas], budget: int, update: bool) -> list[list[Blas]]:
    """Consecutive structures whose scratch fits the budget together; one that doesn't is alone."""
    batches: list[list[Blas]] = []
    scratch = storage = 0
    for blas in blases:
        need = _scratch_size(device, blas, update)
        # Storage before compaction is bounded too: it is several times the scratch.
        if not batches or scratch + need > budget or storage + blas.size > 4 * budget:
            batches.append([])
            scratch = storage = 0
        batches[-1].append(blas)
        scratch += need
        storage += blas.size
    return batches


def _alignment(device: Device) -> int:
    return int(device.properties.acceleration.minAccelerationStructureScratchOffsetAlignment)


def _scratch_size(device: Device, structure: _Structure, update: bool) -> int:
    size = structure.update_scratch_size if update else structure.build_scratch_size
    return -(-size // _alignment(device)) * _alignment(device)


def _make_scratch(device: Device, size: int, name: str) -> tuple[Buffer, int]:
    """A scratch buffer and its first aligned address."""
    alignment = _alignment(device)
    scratch = device.buffer(size + alignment, name)
    return scratch, -(-scratch.address // alignment) * alignment


def _build_batch(device: Device, batch: Sequence[Blas], update: bool) -> None:
    scratch, address = _make_scratch(device, sum(_scratch_size(device, b, update) for b in batch), "blas scratch")
    infos = []
    for blas in batch:
        if blas.handle is None:
            blas._create(blas.size)
        infos.append(blas._build_info(address, update=update))
        address += _scratch_size(device, blas, update)
    infos_array = raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos)
    ranges = raw.array("VkAccelerationStructureBuildRangeInfoKHR*", [blas.ranges for blas in batch])

    def record(cmd: raw.CData) -> None:
        vk = device.vk
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBuildAccelerationStructuresKHR(cmd, len(batch), infos_array, ranges)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    device.start(record, "build blases")
    for blas in batch:
        blas.build_count += 1
    scratch.destroy()


def _compact(device: Device, blases: Sequence[Blas]) -> None:
    """Copy structures just built into storage of the size that they turned out to need."""
    vk = device.vk
    create = raw.struct(
        "VkQueryPoolCreateInfo",
        queryType=raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR,
        queryCount=len(blases),
    )
    pool = device.create("VkQueryPool", create, "compacted sizes")
    try:
        vk.vkResetQueryPool(device.handle, pool, 0, len(blases))
        handles = raw.array("VkAccelerationStructureKHR", [blas.handle for blas in blases])
        kind = raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR
        device.run(
            lambda cmd: vk.vkCmdWriteAccelerationStructuresPropertiesKHR(cmd, len(blases), handles, kind, pool, 0),
            "compacted sizes",
        )
        sizes = np.zeros(len(blases), np.uint64)
        flags = raw.VK_QUERY_RESULT_64_BIT | raw.VK_QUERY_RESULT_WAIT_BIT
        target = raw.ffi.from_buffer(sizes)
        vk.vkGetQueryPoolResults(device.handle, pool, 0, len(blases), sizes.nbytes, target, 8, flags)
    finally:
        device.retire(lambda: vk.vkDestroyQueryPool(device.handle, pool, raw.NULL))
    copies = []
    for blas, size in zip(blases, sizes.tolist(), strict=True):
        if 0 < size < blas.size:
            source, storage, token = blas.handle, blas._storage, blas._token
            blas._create(size)
            copies.append((source, blas.handle, storage, token))
            blas.compacted = True

    def record(cmd: raw.CData) -> None:
        for source, target, _, _ in copies:
            info = raw.struct(
                "VkCopyAccelerationStructureInfoKHR",
                src=source,
                dst=target,
                mode=raw.VK_COPY_ACCELERATION_STRUCTURE_MODE_COMPACT_KHR,
            )
            vk.vkCmdCopyAccelerationStructureKHR(cmd, info)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    if copies:
        device.start(record, "compact blases")
    for _, _, storage, token in copies:
        device.release(token)
        storage.destroy()


class Tlas(_Structure):
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
        self._scratch, self._scratch_address = _make_scratch(device, most, f"{name} scratch")

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


def _geometry(geometry: Geometry) -> raw.CData:
    """The VkAccelerationStructureGeometryKHR of a geometry."""
    flags = raw.VK_GEOMETRY_OPAQUE_BIT_KHR * geometry.opaque
    flags |= raw.VK_GEOMETRY_NO_DUPLICATE_ANY_HIT_INVOCATION_BIT_KHR * geometry.no_duplicate_any_hit
    if isinstance(geometry, AabbGeometry):
        kind = raw.VK_GEOMETRY_TYPE_AABBS_KHR
        data = {
            "aabbs": raw.struct(
                "VkAccelerationStructureGeometryAabbsDataKHR",
                data={"deviceAddress": geometry.boxes},
                stride=geometry.stride,
            )
        }
    else:
        kind = raw.VK_GEOMETRY_TYPE_TRIANGLES_KHR
        index_type = _INDEX_TYPES[np.dtype(geometry.index_dtype)] if geometry.indices else raw.VK_INDEX_TYPE_NONE_KHR
        data = {
            "triangles": raw.struct(
                "VkAccelerationStructureGeometryTrianglesDataKHR",
                vertexFormat=raw.VK_FORMAT_R32G32B32_SFLOAT,
                vertexData={"deviceAddress": geometry.positions},
                vertexStride=geometry.position_stride,
                maxVertex=max(geometry.position_count - 1, 0),
                indexType=index_type,
                indexData={"deviceAddress": geometry.indices},
                transformData={"deviceAddress": geometry.transform},
            )
        }
    return raw.struct("VkAccelerationStructureGeometryKHR", geometryType=kind, geometry=data, flags=flags)


def _check_geometries(device: Device, geometries: Sequence[Geometry], name: str) -> None:
    """Raise SolariError for what vkCmdBuildAccelerationStructuresKHR must not be given."""
    limits = device.properties.acceleration
    where = f"Blas {name}"
    if not 1 <= len(geometries) <= limits.maxGeometryCount:
        raise SolariError(f"{where}: {len(geometries)} geometries; this device takes 1 to {limits.maxGeometryCount:,}")
    if len({type(geometry) for geometry in geometries}) > 1:
        raise SolariError(f"{where}: triangles and boxes can't be in one Blas")
    total = sum(geometry.primitive_count for geometry in geometries)
    if total > limits.maxPrimitiveCount:
        raise SolariError(f"{where}: {total:,} primitives; this device takes {limits.maxPrimitiveCount:,} at most")
    for i, geometry in enumerate(geometries):
        if geometry.primitive_count < 0:
            raise SolariError(f"{where}, geometry {i}: {geometry.primitive_count} primitives")
        if isinstance(geometry, AabbGeometry):
            aligned = {"boxes": (geometry.boxes, 8), "stride": (geometry.stride, 8)}
        else:
            if np.dtype(geometry.index_dtype) not in _INDEX_TYPES:
                raise SolariError(f"{where}, geometry {i}: index_dtype {geometry.index_dtype}, not uint16 or uint32")
            size = np.dtype(geometry.index_dtype).itemsize
            aligned = {
                "positions": (geometry.positions, 4),
                "position_stride": (geometry.position_stride, 4),
                "indices": (geometry.indices, size),
                "transform": (geometry.transform, 16),
            }
            if not geometry.indices and geometry.position_count < 3 * geometry.triangle_count:
                raise SolariError(
                    f"{where}, geometry {i}: {geometry.triangle_count:,} triangles without indices "
                    f"need {3 * geometry.triangle_count:,} positions, not {geometry.position_count:,}"
                )
        for field, (value, alignment) in aligned.items():
            if value < 0 or value % alignment:
                raise SolariError(f"{where}, geometry {i}: {field} is {value:#x}, not a multiple of {alignment}")
