"""What bottom- and top-level acceleration structures share: sizes, storage, handle and build commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.memory import Buffer

if TYPE_CHECKING:
    from solari_vk.gpu.device import Device

_STORAGE_USAGE = (
    raw.VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR | raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
)


class Structure:
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


def _alignment(device: Device) -> int:
    return int(device.properties.acceleration.minAccelerationStructureScratchOffsetAlignment)


def scratch_size(device: Device, structure: Structure, update: bool) -> int:
    size = structure.update_scratch_size if update else structure.build_scratch_size
    return -(-size // _alignment(device)) * _alignment(device)


def make_scratch(device: Device, size: int, name: str) -> tuple[Buffer, int]:
    """A scratch buffer and its first aligned address."""
    alignment = _alignment(device)
    scratch = device.buffer(size + alignment, name)
    return scratch, -(-scratch.address // alignment) * alignment
