"""Buffers: made in sub-allocated memory, seen as numpy arrays, uploaded and read back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.image import Image as Image
from solari_vk.gpu.device.image import Sampler as Sampler
from solari_vk.gpu.device.uploads import Uploads as Uploads
from solari_vk.gpu.device.uploads import as_bytes, read_back

if TYPE_CHECKING:
    from solari_vk.gpu.device.device import Device

BUFFER_USAGE = (
    raw.VK_BUFFER_USAGE_TRANSFER_SRC_BIT
    | raw.VK_BUFFER_USAGE_TRANSFER_DST_BIT
    | raw.VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT
    | raw.VK_BUFFER_USAGE_STORAGE_BUFFER_BIT
    | raw.VK_BUFFER_USAGE_INDEX_BUFFER_BIT
    | raw.VK_BUFFER_USAGE_VERTEX_BUFFER_BIT
    | raw.VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT
    | raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
    | raw.VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_BIT_KHR
)


class Buffer:
    """Device memory of `size` bytes. `host=True` puts it where the host can always see it (`view`).

    `address` is its device address (0 without that usage). Contents start undefined; `fill` sets them.
    A size of 0 is allowed and holds nothing. Raises DeviceError beyond the device's limits.
    """

    def __init__(
        self, device: Device, size_bytes: int, name: str, *, host: bool = False, usage: int = BUFFER_USAGE
    ) -> None:
        self.device = device
        self.size = int(size_bytes)
        self.name = name
        self.usage = usage
        limit = min(device.properties.max_buffer_size, device.properties.max_allocation_size)
        if not 0 <= self.size <= limit:
            raise DeviceError(
                f"buffer {name}: {self.size:,} bytes, but this device's buffers hold at most {limit:,}: "
                "use a smaller scene or picture"
            )
        create = raw.struct("VkBufferCreateInfo", size=max(-(-self.size // 16) * 16, 16), usage=usage)
        self.handle = handle = device.create("VkBuffer", create, name)
        requirements = raw.ffi.new("VkMemoryRequirements*")
        device.vk.vkGetBufferMemoryRequirements(device.handle, handle, requirements)
        try:
            allocation = device.memory.allocate(requirements, f"buffer {name}", host=host)
        except BaseException:
            device.vk.vkDestroyBuffer(device.handle, handle, raw.NULL)
            raise
        device.vk.vkBindBufferMemory(device.handle, handle, allocation.memory, allocation.offset)

        def destroy() -> None:
            device.vk.vkDestroyBuffer(device.handle, handle, raw.NULL)
            device.memory.free(allocation)

        self._token = device.own(destroy)
        self._pointer = allocation.pointer
        self._cached = allocation.cached
        self.mapped = self._pointer is not None
        self.address = 0
        if usage & raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT:
            info = raw.struct("VkBufferDeviceAddressInfo", buffer=handle)
            self.address = int(device.vk.vkGetBufferDeviceAddress(device.handle, info))

    def __repr__(self) -> str:
        return f"<Buffer {self.name}: {self.size:,} bytes>"

    def check_range(self, offset: int, size: int, action: str) -> None:
        """Raise SolariError unless the bytes lie inside the buffer and the buffer still exists."""
        if self.device.closed:
            raise DeviceError(f"{action} of buffer {self.name}, whose device was closed")
        if self.handle is None:
            raise SolariError(f"{action} of buffer {self.name}, which was destroyed")
        if offset < 0 or size < 0 or offset + size > self.size:
            raise SolariError(
                f"{action} of buffer {self.name}: bytes {offset:,} to {offset + size:,} of {self.size:,}"
            )

    def view(self, dtype: Any = np.uint8, count: int = -1, offset: int = 0) -> np.ndarray:
        """A live array over mapped memory, valid until `destroy`; the device sees writes at the next submission.

        The caller keeps clear of what running work uses. Raises SolariError for memory that isn't mapped.
        """
        dtype = np.dtype(dtype)
        if count < 0:
            count = (self.size - offset) // dtype.itemsize
        self.check_range(offset, count * dtype.itemsize, "view")
        if self._pointer is None:
            raise SolariError(f"buffer {self.name} is in device memory: make it with host=True, or use upload and read")
        if not count:
            return np.empty(0, dtype)
        return np.frombuffer(raw.ffi.buffer(self._pointer + offset, count * dtype.itemsize), dtype)

    def write(self, data: Any, offset: int = 0) -> None:
        """Write bytes through the mapping at once, whatever the device is doing."""
        source = as_bytes(data)
        self.check_range(offset, source.size, "write")
        if self._pointer is None:
            raise SolariError(f"buffer {self.name} is in device memory: use upload")
        if source.size:
            raw.ffi.memmove(self._pointer + offset, source, source.size)

    def upload(self, data: Any, offset: int = 0) -> None:
        """Replace bytes, after all work submitted so far and before all that follows."""
        with self.device.uploads() as uploads:
            uploads.buffer(self, data, offset)

    def fill(self, value: int = 0) -> None:
        """Set every 32-bit word, just before the next submission."""
        self.check_range(0, 0, "fill")

        def record(cmd: raw.CData) -> None:
            if self.handle is not None:
                vk = self.device.vk
                vk.vkCmdPipelineBarrier2(cmd, full_barrier())
                vk.vkCmdFillBuffer(cmd, self.handle, 0, raw.VK_WHOLE_SIZE, value)
                vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        self.device.before_next_submit(record)

    def read(self, dtype: Any = np.uint8, count: int = -1, offset: int = 0) -> np.ndarray:
        """A copy of the contents after all work submitted so far; waits for it."""
        dtype = np.dtype(dtype)
        if count < 0:
            count = (self.size - offset) // dtype.itemsize
        size = count * dtype.itemsize
        self.check_range(offset, size, "read")
        if not size:
            return np.empty(0, dtype)
        if self.mapped and self._cached:
            self.device.sync_host()
            return self.view(dtype, count, offset).copy()
        # Uncached memory is read through a copy as well: the host reads it at a crawl.
        return read_back(
            self.device,
            size,
            lambda cmd, target: self.device.vk.vkCmdCopyBuffer(
                cmd, self.handle, target, 1, raw.struct("VkBufferCopy", srcOffset=offset, size=size)
            ),
        ).view(dtype)

    def destroy(self) -> None:
        """Destroy the buffer when the work submitted so far is done. Safe to call twice."""
        self.handle = None
        self._pointer = None
        self.device.release(self._token)
