"""The base of bottom- and top-level acceleration structures: sizes, storage, handle, build commands, build times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from solari_vk.base.errors import SolariError, quoted
from solari_vk.gpu.acceleration.checks import check_kind, check_switch, whole_number
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.storage import Storage

_STORAGE_USAGE = (
    raw.VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR | raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
)
_ALLOW_DATA_ACCESS = 0x800  # VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_DATA_ACCESS_KHR, which the package lacks


class UpdateMode(Enum):
    """Whether a build call rebuilds a structure that was built before, or refits it where it can."""

    BUILD = "build"
    PREFER_UPDATE = "prefer update"


@dataclass(frozen=True)
class BuildOptions:
    """How a structure is built. Raises SolariError for values of wrong types.

    prefer_fast_trace: prefer fast rays to fast builds. low_memory: prefer small structures. update_mode: with
    PREFER_UPDATE a build call refits where it can, but rebuilds after `rebuild_after` refits in a row, because refits
    make the bounding boxes of moving geometry looser and rays slower.
    """

    prefer_fast_trace: bool = True
    low_memory: bool = False
    update_mode: UpdateMode = UpdateMode.BUILD
    rebuild_after: int = 32

    def __post_init__(self) -> None:
        what = "acceleration structure"
        check_switch(self.prefer_fast_trace, f"{what}: prefer_fast_trace")
        check_switch(self.low_memory, f"{what}: low_memory")
        check_kind(self.update_mode, UpdateMode, f"{what}: update_mode", "give rt.UpdateMode.BUILD or PREFER_UPDATE")
        whole_number(self.rebuild_after, f"{what}: rebuild_after", 0)

    def flags(self, device: Device) -> int:
        """Vulkan's build flags. With position fetch, shaders can read the vertices of hit triangles."""
        # Vulkan forbids both preferences at once.
        trace = raw.VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_TRACE_BIT_KHR
        build = raw.VK_BUILD_ACCELERATION_STRUCTURE_PREFER_FAST_BUILD_BIT_KHR
        flags = trace if self.prefer_fast_trace else build
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_LOW_MEMORY_BIT_KHR * self.low_memory
        if self.update_mode is UpdateMode.PREFER_UPDATE:
            flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_UPDATE_BIT_KHR
        return int(flags | _ALLOW_DATA_ACCESS * device.has_position_fetch)


class Clock:
    """Counts build calls and destructions. Their order decides whether a top-level structure may be used."""

    def __init__(self) -> None:
        self.now = 0

    def tick(self) -> int:
        """Count an event; returns its time."""
        self.now += 1
        return self.now


clock = Clock()


class Structure:
    """The base of Blas and Tlas.

    `built_at` is the time (of `clock`) of the latest build call, 0 before the first.
    """

    def __init__(
        self,
        device: Device,
        kind: int,
        options: BuildOptions,
        geometries: Sequence[raw.CData],
        counts: list[int],
        name: str,
        *,
        more_flags: int = 0,
    ) -> None:
        check_kind(name, str, "acceleration structure: the name", "give a string")
        if device.rays == "compute":
            usable = [rays for rays in ("query", "pipeline") if not device.missing_rays[rays]]
            remedy = f"open it with rays={quoted(usable[0])}" if usable else "take a device with ray queries"
            raise SolariError(
                f"{type(self).__name__} {name}: acceleration structures are off on a device that traces by compute "
                f"shaders: {remedy}"
            )
        self.device = device
        self.name = name
        self.options = options
        self.flags = options.flags(device) | more_flags
        self.handle: raw.CData | None = None
        self.address = 0
        self.build_count = 0
        self.built_at = 0
        self.refit_count = 0
        self.destroyed = False
        self._kind = kind
        # The array lives as long as the structure, because each build points to it.
        self._geometries = raw.array("VkAccelerationStructureGeometryKHR", geometries)
        self._geometry_count = len(geometries)
        # The sizes follow from the flags and the largest counts alone; no address is read here.
        sizes = raw.struct("VkAccelerationStructureBuildSizesInfoKHR")
        device.vk.vkGetAccelerationStructureBuildSizesKHR(
            device.handle,
            raw.VK_ACCELERATION_STRUCTURE_BUILD_TYPE_DEVICE_KHR,
            self.build_info(),
            raw.ffi.new("uint32_t[]", counts),
            sizes,
        )
        self.size = int(sizes.accelerationStructureSize)
        self.build_scratch_size = int(sizes.buildScratchSize)
        self.update_scratch_size = int(sizes.updateScratchSize)

    def __repr__(self) -> str:
        if self.destroyed:
            return f"<{self.describe()}: destroyed>"
        return f"<{self.describe()}: {self.size:,} bytes, built {self.build_count} times>"

    @property
    def built(self) -> bool:
        """Whether a build was recorded or submitted."""
        return self.build_count > 0

    @property
    def allow_update(self) -> bool:
        """Whether it can be refitted."""
        return self.options.update_mode is UpdateMode.PREFER_UPDATE

    def create(self, size: int) -> None:
        """Make storage, handle and address, without building."""
        device = self.device
        with device.undone_on_error():
            self._storage = Storage(device.memory, size, f"{self.name} storage", usage=_STORAGE_USAGE)
            create = raw.struct(
                "VkAccelerationStructureCreateInfoKHR", buffer=self._storage.handle, size=size, type=self._kind
            )
            self.handle = handle = device.create("VkAccelerationStructureKHR", create, self.name)
        self._token = device.register(
            lambda: device.vk.vkDestroyAccelerationStructureKHR(device.handle, handle, raw.NULL)
        )
        # Instances refer to a structure by its address, and descriptors by its handle.
        info = raw.struct("VkAccelerationStructureDeviceAddressInfoKHR", accelerationStructure=handle)
        self.address = int(device.vk.vkGetAccelerationStructureDeviceAddressKHR(device.handle, info))
        self.size = size

    def build_info(self, scratch: int = 0, *, update: bool = False, source: Structure | None = None) -> raw.CData:
        """The VkAccelerationStructureBuildGeometryInfoKHR of a build or, with `update`, a refit.

        source: the structure of the same kind of geometry that a refit starts from, by default this one.
        """
        build = raw.VK_BUILD_ACCELERATION_STRUCTURE_MODE_BUILD_KHR
        refit = raw.VK_BUILD_ACCELERATION_STRUCTURE_MODE_UPDATE_KHR
        return raw.struct(
            "VkAccelerationStructureBuildGeometryInfoKHR",
            type=self._kind,
            flags=self.flags,
            mode=refit if update else build,
            # A refit may read one structure and write another, so that rays of an earlier frame keep the first one.
            srcAccelerationStructure=(source or self).handle if update else None,
            dstAccelerationStructure=self.handle,
            geometryCount=self._geometry_count,
            pGeometries=self._geometries,
            scratchData={"deviceAddress": scratch},
        )

    def mark_built(self, at: int, *, update: bool = False) -> None:
        """Record that a build call at this time builds or, with `update`, refits the structure."""
        self.build_count += 1
        self.built_at = at
        self.refit_count = self.refit_count + 1 if update else 0

    def check_alive(self, action: str, device: Device | None = None) -> None:
        """Raise SolariError if the structure was destroyed or, given a device, belongs to another one."""
        if self.destroyed:
            raise SolariError(f"{action} of {self.describe()}, which was destroyed")
        if device is not None:
            device.check_owns(self, f"{action} of {self.describe()}, which")

    def describe(self) -> str:
        """Its name in messages."""
        return f"{type(self).__name__} {self.name}"

    @property
    def prefers_update(self) -> bool:
        """Whether its update mode and the number of refits so far allow another refit."""
        return self.allow_update and self.built and self.refit_count < self.options.rebuild_after

    def check_update(self) -> None:
        """Raise SolariError if it can't be refitted."""
        if not self.allow_update or not self.built:
            why = "it was made without UpdateMode.PREFER_UPDATE" if not self.allow_update else "it was never built"
            raise SolariError(f"refit of {self.describe()}: {why}")

    def destroy(self) -> None:
        """Destroy it when the work submitted so far is done. Safe to call twice."""
        if not self.destroyed:
            # A Tlas that was built before this moment may refer to what is gone: `check_usable` compares times.
            clock.tick()
        self.destroyed = True
        if self.handle is not None:
            self.device.release(self._token)
            self._storage.destroy()
            self.handle = None
            self.address = 0


def _alignment(device: Device) -> int:
    return int(device.properties.acceleration.minAccelerationStructureScratchOffsetAlignment)


def scratch_size(device: Device, structure: Structure, update: bool) -> int:
    """The scratch bytes of a build or refit, rounded up so that another structure's scratch can follow."""
    # Scratch of several builds lies in one buffer, and the driver wants each part aligned.
    size = structure.update_scratch_size if update else structure.build_scratch_size
    return -(-size // _alignment(device)) * _alignment(device)


def make_scratch(device: Device, size: int, name: str) -> tuple[Storage, int]:
    """A scratch buffer and its first aligned address."""
    alignment = _alignment(device)
    # A buffer's own address may be less aligned than scratch must be: there is room to move up.
    scratch = device.buffer(size + alignment, name)
    return scratch, -(-scratch.address // alignment) * alignment
