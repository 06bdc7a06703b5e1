"""A VkBuffer in sub-allocated memory, seen as numpy arrays where that memory is mapped."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.allocator import Allocation, Allocator

# All usages that any caller needs, so that every buffer can be used anywhere.
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


class Storage:
    """`size` bytes behind a VkBuffer. Staging uses it as it is; `Buffer` adds uploads and reads.

    host: put the bytes in memory that the host can always see. shared: see `WorkQueue.share`. use: what
    `Allocator.bytes_by_use` counts it for. `address` is the device
    address, or 0 without that usage. A size of 0 is allowed. Raises DeviceError beyond the device's limits.
    """

    def __init__(
        self,
        memory: Allocator,
        size_bytes: int,
        name: str,
        *,
        host: bool = False,
        usage: int = BUFFER_USAGE,
        shared: bool = False,
        use: str = "",
    ) -> None:
        self.device = device = memory.device
        self.size = int(size_bytes)
        self.name = name
        # maxMemoryAllocationSize may be smaller than maxBufferSize, and a buffer lies in one allocation.
        limit = min(device.properties.max_buffer_size, device.properties.max_allocation_size)
        if not 0 <= self.size <= limit:
            raise DeviceError(
                f"buffer {name}: {self.size:,} bytes, but this device's buffers hold at most {limit:,}: "
                "use a smaller scene or picture"
            )
        # Vulkan has no empty buffers.
        create = raw.struct("VkBufferCreateInfo", size=max(-(-self.size // 16) * 16, 16), usage=usage)
        self.handle = handle = device.create("VkBuffer", create, name)
        requirements = raw.ffi.new("VkMemoryRequirements*")
        device.vk.vkGetBufferMemoryRequirements(device.handle, handle, requirements)
        allocation: Allocation | None = None

        def destroy() -> None:
            device.vk.vkDestroyBuffer(device.handle, handle, raw.NULL)
            if allocation is not None:
                memory.free(allocation)

        with device.undone_on_error():
            # Registered before memory is bound, so that an error below destroys the buffer.
            self._token = device.register(destroy)
            allocation = memory.allocate(requirements, f"buffer {name}", host=host, use=use)
            device.vk.vkBindBufferMemory(device.handle, handle, allocation.memory, allocation.offset)
        if shared:
            device.share(self._token)
        self._pointer = allocation.pointer
        self._cached = allocation.cached
        self.mapped = self._pointer is not None
        self.address = 0
        if usage & raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT:
            info = raw.struct("VkBufferDeviceAddressInfo", buffer=handle)
            self.address = int(device.vk.vkGetBufferDeviceAddress(device.handle, info))

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.size:,} bytes>"

    def check_range(self, offset: int, size: int, action: str) -> None:
        """Raise SolariError unless the buffer exists and the bytes lie inside it."""
        if self.device.closed:
            raise DeviceError(f"{action} of buffer {self.name}: {self.device.name} {self.device.closed_how}")
        if self.handle is None:
            raise SolariError(f"{action} of buffer {self.name}, which was destroyed")
        if offset < 0 or size < 0 or offset + size > self.size:
            raise SolariError(f"{action} of buffer {self.name}: bytes {offset:,} to {offset + size:,} of {self.size:,}")

    def _typed_range(self, dtype: Any, count: int, offset: int, action: str) -> tuple[np.dtype[Any], int]:
        """The dtype and the element count, checked; a negative count means all elements from the offset on."""
        dtype = np.dtype(dtype)
        if count < 0:
            count = (self.size - offset) // dtype.itemsize
        self.check_range(offset, count * dtype.itemsize, action)
        return dtype, count

    def view(self, dtype: Any = np.uint8, count: int = -1, offset: int = 0) -> np.ndarray:
        """A live array over mapped memory, valid until `destroy`; the device sees writes at the next submission.

        The caller must not write what running work uses. Raises SolariError for memory that isn't mapped.
        """
        dtype, count = self._typed_range(dtype, count, offset, "view")
        if self._pointer is None:
            raise SolariError(f"buffer {self.name} is in device memory: make it with host=True, or use upload and read")
        if not count:
            return np.empty(0, dtype)
        return np.frombuffer(raw.ffi.buffer(self._pointer + offset, count * dtype.itemsize), dtype)

    def write(self, data: Any, offset: int = 0) -> None:
        """Write bytes through the mapping at once, without waiting for running work."""
        source = as_bytes(data)
        self.check_range(offset, source.size, "write")
        if self._pointer is None:
            raise SolariError(f"buffer {self.name} is in device memory: use upload")
        if source.size:
            raw.ffi.memmove(self._pointer + offset, source, source.size)

    def destroy(self) -> None:
        """Destroy the buffer when the work submitted so far is done. Safe to call twice."""
        self.handle = None
        self._pointer = None
        self.device.release(self._token)


def as_bytes(data: Any) -> np.ndarray:
    """An array or a bytes-like object as a flat, contiguous array of bytes, copied only if it must be."""
    if isinstance(data, (bytes, bytearray, memoryview)):
        return np.frombuffer(data, np.uint8)
    return np.ascontiguousarray(data).reshape(-1).view(np.uint8)
