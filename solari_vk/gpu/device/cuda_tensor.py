"""Copies of buffers, on the device, that CUDA's libraries take as tensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device import dlpack, raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import ALL_COMMANDS, WRITE, full_barrier
from solari_vk.gpu.device.cuda import Cuda, CudaEvent, CudaMemory
from solari_vk.gpu.device.recorded import Recorded
from solari_vk.gpu.device.work_queue import WorkQueue

EXTENSIONS = ("VK_KHR_external_memory_fd", "VK_KHR_external_semaphore_fd")
_FD = raw.VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT
_SEMAPHORE_FD = raw.VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT
_USAGE = raw.VK_BUFFER_USAGE_TRANSFER_DST_BIT | raw.VK_BUFFER_USAGE_TRANSFER_SRC_BIT
_NO_SYNC = -1  # DLPack: the consumer takes care
_KEPT = 2  # free places of a size, for the next tensors


class _Place:
    """A buffer in memory that CUDA maps too, and what its users need."""

    def __init__(self, device: WorkQueue, memory: Allocator, cuda: Cuda, size: int) -> None:
        self.size, self.cuda, self._device = size, cuda, device
        self._events: list[CudaEvent] = []  # consumers' work that may still read
        external = raw.struct("VkExternalMemoryBufferCreateInfo", handleTypes=_FD)
        create = raw.struct("VkBufferCreateInfo", pNext=external, size=size, usage=_USAGE)
        vk = device.vk
        with ExitStack() as undo:
            self.handle = device.create("VkBuffer", create, "tensor")
            undo.callback(lambda: vk.vkDestroyBuffer(device.handle, self.handle, raw.NULL))
            requirements = raw.ffi.new("VkMemoryRequirements*")
            vk.vkGetBufferMemoryRequirements(device.handle, self.handle, requirements)
            dedicated = raw.struct("VkMemoryDedicatedAllocateInfo", buffer=self.handle)
            allocate = raw.struct(
                "VkMemoryAllocateInfo",
                pNext=raw.struct("VkExportMemoryAllocateInfo", pNext=dedicated, handleTypes=_FD),
                allocationSize=requirements.size,
                memoryTypeIndex=memory.choose_type(requirements.memoryTypeBits, "tensor", host=False),
            )
            allocated = raw.ffi.new("VkDeviceMemory*")
            vk.vkAllocateMemory(device.handle, allocate, raw.NULL, allocated)
            undo.callback(lambda: vk.vkFreeMemory(device.handle, allocated[0], raw.NULL))
            vk.vkBindBufferMemory(device.handle, self.handle, allocated[0], 0)
            fd = raw.ffi.new("int*")
            info = raw.struct("VkMemoryGetFdInfoKHR", memory=allocated[0], handleType=_FD)
            vk.vkGetMemoryFdKHR(device.handle, info, fd)
            self.memory = CudaMemory(cuda, fd[0], int(requirements.size), size)
            undo.callback(self.memory.close)
            self.close = undo.pop_all().close

    @property
    def to_cuda(self) -> raw.CData:
        """The barrier after which CUDA owns the buffer. What it held isn't asked for when Vulkan writes again."""
        barrier = raw.struct(
            "VkBufferMemoryBarrier2",
            srcStageMask=ALL_COMMANDS,
            srcAccessMask=WRITE,
            dstStageMask=ALL_COMMANDS,
            srcQueueFamilyIndex=self._device.queue_family,
            dstQueueFamilyIndex=raw.VK_QUEUE_FAMILY_EXTERNAL,
            buffer=self.handle,
            size=raw.VK_WHOLE_SIZE,
        )
        return raw.struct("VkDependencyInfo", bufferMemoryBarrierCount=1, pBufferMemoryBarriers=barrier)

    def release(self, stream: int) -> None:
        """Note that a stream gets no more work that reads. Any thread may call this."""
        event = CudaEvent(self.cuda)
        event.record(stream)
        self._events.append(event)

    def await_consumers(self) -> None:
        """Wait until no work reads any more, which is so already unless consumers fall behind."""
        while self._events:
            event = self._events.pop()
            event.wait()
            event.close()


class _Lease:
    """A use of a place, until nobody needs it: `Lent` is told when this object is gone."""

    def __init__(self, place: _Place) -> None:
        self.place = place


class CudaTensor:
    """A tensor in CUDA's memory, for `torch.from_dlpack`, `cupy.from_dlpack` and `jax.dlpack.from_dlpack`.

    shape, dtype: as of numpy arrays. Later frames don't change it. Work of the stream that takes it waits on the device
    until it is written; the host doesn't wait. It may outlive what it was made from.
    """

    def __init__(self, lease: _Lease, semaphore: Any, value: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype
        self._lease, self._semaphore, self._value = lease, semaphore, value

    def reshape(self, *shape: int) -> CudaTensor:
        """The same memory as a tensor of another shape."""
        if math.prod(shape) != math.prod(self.shape):
            raise SolariError(f"a tensor of the shape {self.shape} can't have the shape {shape}")
        return CudaTensor(self._lease, self._semaphore, self._value, shape, self.dtype)

    def __dlpack_device__(self) -> tuple[int, int]:
        return dlpack.CUDA, self._lease.place.cuda.ordinal

    def __dlpack__(self, *, stream: int | None = None, **_: Any) -> Any:
        """A capsule. stream: the consumer's, as the array API standard has it; -1 for one that waits by itself."""
        lease, stream = self._lease, 0 if stream is None else int(stream)
        if stream == _NO_SYNC:
            stream = 0
        else:
            lease.place.cuda.wait(self._semaphore, self._value, stream)
        return dlpack.capsule(
            lease.place.memory.address, self.shape, self.dtype, self.__dlpack_device__(),
            lambda: lease.place.release(stream),
        )  # fmt: skip

    def __repr__(self) -> str:
        return f"<CudaTensor {self.shape} {self.dtype} on CUDA device {self._lease.place.cuda.ordinal}>"


class CudaTensors:
    """Makes tensors of a device. Raises DeviceError, with the reason, for a device that CUDA can't share."""

    def __init__(self, device: WorkQueue, memory: Allocator) -> None:
        if missing := [name for name in EXTENSIONS if name not in device.extensions]:
            raise DeviceError(f"{device.name} lacks {' and '.join(missing)}")
        self._device, self._memory = device, memory
        self.cuda = Cuda(device.properties.uuid)
        export = raw.struct("VkExportSemaphoreCreateInfo", handleTypes=_SEMAPHORE_FD)
        timeline = raw.struct("VkSemaphoreTypeCreateInfo", pNext=export, semaphoreType=raw.VK_SEMAPHORE_TYPE_TIMELINE)
        self._timeline = device.create("VkSemaphore", raw.struct("VkSemaphoreCreateInfo", pNext=timeline), "tensors")
        info = raw.struct("VkSemaphoreGetFdInfoKHR", semaphore=self._timeline, handleType=_SEMAPHORE_FD)
        fd = raw.ffi.new("int*")
        device.vk.vkGetSemaphoreFdKHR(device.handle, info, fd)
        self._semaphore = self.cuda.import_timeline(fd[0])
        self._value = 0
        self._free: dict[int, list[_Place]] = {}
        device.share(device.own(self._close))

    def copy(
        self, record_copy: Callable[[raw.CData, raw.CData], None], shape: tuple[int, ...], dtype: np.dtype[Any]
    ) -> CudaTensor:
        """A tensor of what `record_copy(command buffer, VkBuffer)` copies. uint32 becomes int32, since few libraries
        compute with it: 2^32 - 1, of no instance, is -1."""
        device = self._device
        place = self._take(math.prod(shape) * dtype.itemsize)
        if dtype == np.uint32:
            dtype = np.dtype(np.int32)

        def record(cmd: raw.CData) -> None:
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            record_copy(cmd, place.handle)
            device.vk.vkCmdPipelineBarrier2(cmd, place.to_cuda)

        copying = Recorded(device, record, "tensor")
        self._value += 1
        device.submit_prepared(device.submission([copying.commands], signals=[(self._timeline, self._value)]))
        copying.destroy()
        lease = _Lease(place)
        device.lent.lend(lease, partial(self._give_back, place))
        return CudaTensor(lease, self._semaphore, self._value, shape, dtype)

    def _take(self, size: int) -> _Place:
        free = self._free.get(size)
        place = free.pop() if free else _Place(self._device, self._memory, self.cuda, size)
        place.await_consumers()
        return place

    def _give_back(self, place: _Place) -> None:
        """Nobody has the tensor any more."""
        free = self._free.setdefault(place.size, [])
        free.append(place)
        if len(free) > _KEPT and not self._device.closed:
            self._device.retire(partial(self._discard, free.pop(0)))  # a copy to it may be due

    def _discard(self, place: _Place) -> None:
        place.await_consumers()
        place.close()

    def _close(self) -> None:
        for place in [place for places in self._free.values() for place in places]:
            self._discard(place)
        self._free.clear()
        self.cuda.destroy_semaphore(self._semaphore)
        self._device.vk.vkDestroySemaphore(self._device.handle, self._timeline, raw.NULL)
        self.cuda.close()
