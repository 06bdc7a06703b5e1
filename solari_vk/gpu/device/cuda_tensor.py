"""Copies of buffers, on the device, that CUDA's libraries take as tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import numpy as np

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import dlpack, raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import ALL_COMMANDS, READ, WRITE, full_barrier
from solari_vk.gpu.device.cuda import Cuda, CudaEvent, CudaMemory, Hip
from solari_vk.gpu.device.places import Lease, Places
from solari_vk.gpu.device.recorded import Recorded
from solari_vk.gpu.device.submission import SemaphoreValue
from solari_vk.gpu.device.work_queue import WorkQueue

MEMORY, SEMAPHORE, PCI = "VK_KHR_external_memory_fd", "VK_KHR_external_semaphore_fd", "VK_EXT_pci_bus_info"
AMD = 0x1002  # the vendor's number at PCI-SIG
_FD = raw.VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT
_SEMAPHORE_FD = raw.VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT
_USAGE = raw.VK_BUFFER_USAGE_TRANSFER_DST_BIT | raw.VK_BUFFER_USAGE_TRANSFER_SRC_BIT
NO_SYNC = -1  # DLPack: the consumer takes care


class Place:
    """A buffer in memory that CUDA maps too, and what its users need."""

    def __init__(self, device: WorkQueue, memory: Allocator, cuda: Cuda, size: int) -> None:
        self.size, self.cuda, self._device = size, cuda, device
        self._events: list[CudaEvent] = []  # consumers' work that may still read
        self._read_anywhere = False  # a consumer may have read in any stream
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
            self._free = undo.pop_all().close

    def close(self) -> None:
        """Free it when no work reads it any more."""
        with suppress(DeviceError):
            self.await_consumers()
        self._free()

    @property
    def to_cuda(self) -> raw.CData:
        """The barrier after which CUDA owns the buffer. What it held isn't asked for when Vulkan writes again."""
        return self._handing_over(self._device.queue_family, raw.VK_QUEUE_FAMILY_EXTERNAL)

    @property
    def from_cuda(self) -> raw.CData:
        """The barrier after which Vulkan owns the buffer, with what CUDA wrote."""
        return self._handing_over(raw.VK_QUEUE_FAMILY_EXTERNAL, self._device.queue_family)

    def _handing_over(self, source: int, target: int) -> raw.CData:
        barrier = raw.struct(
            "VkBufferMemoryBarrier2",
            srcStageMask=ALL_COMMANDS,
            srcAccessMask=WRITE,
            dstStageMask=ALL_COMMANDS,
            dstAccessMask=READ,
            srcQueueFamilyIndex=source,
            dstQueueFamilyIndex=target,
            buffer=self.handle,
            size=raw.VK_WHOLE_SIZE,
        )
        return raw.struct("VkDependencyInfo", bufferMemoryBarrierCount=1, pBufferMemoryBarriers=barrier)

    def release(self, stream: int | None) -> None:
        """Note that a stream, or None for any, gets no more work that reads. Any thread may call this."""
        if stream is None:
            self._read_anywhere = True
            return
        event = CudaEvent(self.cuda)
        event.record(stream)
        self._events.append(event)

    def await_consumers(self) -> None:
        """Wait until no work reads any more, which is so already unless consumers fall behind."""
        if self._read_anywhere:
            self.cuda.synchronize()
            self._read_anywhere = False
        while self._events:
            event = self._events.pop()
            event.wait()
            event.close()


class CudaTensor:
    """A tensor in memory of CUDA, or of AMD's HIP, for `torch.from_dlpack`, `cupy.from_dlpack` and
    `jax.dlpack.from_dlpack`.

    shape, dtype: as of numpy arrays. Later frames don't change it. Work of the stream that takes it waits on the device
    until it is written; the host doesn't wait, but with HIP, and with a consumer that says that it waits by itself.
    Work of other streams must wait for that stream, and it for them before the tensor is dropped, as PyTorch has it for
    its own. It may outlive what it was made from.
    """

    def __init__(
        self,
        lease: Lease[Place],
        await_written: Callable[[int | None], None],
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
    ) -> None:
        self.shape, self.dtype = shape, dtype
        self._lease, self._await_written = lease, await_written

    def reshape(self, *shape: int) -> CudaTensor:
        """The same memory as a tensor of another shape."""
        if math.prod(shape) != math.prod(self.shape):
            raise SolariError(f"a tensor of the shape {self.shape} can't have the shape {shape}")
        return CudaTensor(self._lease, self._await_written, shape, self.dtype)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._lease.place.cuda.dlpack_type, self._lease.place.cuda.ordinal

    def __dlpack__(self, *, stream: int | None = None, **_: Any) -> Any:
        """A capsule. stream: the consumer's, as the array API standard has it. For -1, which names none, the host waits
        until the tensor is written, and before its memory is used again for all streams."""
        lease = self._lease
        reader = None if stream == NO_SYNC else int(stream or 0)
        self._await_written(reader)
        return dlpack.capsule(
            lease.place.memory.address,
            self.shape,
            self.dtype,
            self.__dlpack_device__(),
            lambda: lease.place.release(reader),
        )

    def __repr__(self) -> str:
        cuda = self._lease.place.cuda
        return f"<CudaTensor {self.shape} {self.dtype} on {cuda.name} device {cuda.ordinal}>"


class CudaTensors:
    """Makes tensors of a device. Raises DeviceError, with the reason, for a device that neither CUDA nor HIP shares."""

    def __init__(self, device: WorkQueue, memory: Allocator) -> None:
        driver: type[Cuda] = Hip if device.properties.vendor_id == AMD else Cuda
        needed = (MEMORY, SEMAPHORE) if driver.waits_for_timelines else (MEMORY,)
        if missing := [name for name in needed if name not in device.extensions]:
            raise DeviceError(f"{device.name} lacks {' and '.join(missing)}")
        self._device, self.memory = device, memory
        self.cuda = driver(device.properties.uuid if driver is Cuda else pci_address(device))
        self._value = 0
        self._places = Places(device, partial(Place, device, memory, self.cuda))
        self._timeline = self._semaphore = None
        with ExitStack() as undo:
            undo.callback(self.cuda.close)
            if driver.waits_for_timelines:
                self._timeline, self._semaphore = shared_timeline(device, self.cuda, undo)
            undo.callback(self._places.close)
            self._end = undo.pop_all().close
        device.share(device.own(self._close))

    def copy(
        self, record_copy: Callable[[raw.CData, raw.CData], None], shape: tuple[int, ...], dtype: np.dtype[Any]
    ) -> CudaTensor:
        """A tensor of what `record_copy(command buffer, VkBuffer)` copies. uint32 becomes int32, since few libraries
        compute with it: 2^32 - 1, of no instance, is -1."""
        device = self._device
        place = self._places.take(math.prod(shape) * dtype.itemsize)
        place.await_consumers()
        if dtype == np.uint32:
            dtype = np.dtype(np.int32)

        def record(cmd: raw.CData) -> None:
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            record_copy(cmd, place.handle)
            device.vk.vkCmdPipelineBarrier2(cmd, place.to_cuda)

        copying = Recorded(device, record, "tensor")
        await_written = self.submit(copying.commands)
        copying.destroy()
        return CudaTensor(self._places.lend(place, place.size), await_written, shape, dtype)

    def submit(self, commands: raw.CData, waits: Sequence[SemaphoreValue] = ()) -> Callable[[int | None], None]:
        """Submit commands, which wait for semaphores. Returns what has a stream wait for them, or, with None and where
        streams can't, the host."""
        device, value = self._device, self._value + 1
        signals = [] if self._timeline is None else [(self._timeline, value)]
        submitted = device.submit_prepared(device.submission([commands], waits, signals))
        self._value = value

        def wait(stream: int | None) -> None:
            if self._semaphore is None or stream is None:
                device.await_value(submitted)
            else:
                self.cuda.wait(self._semaphore, value, stream)

        return wait

    def _close(self) -> None:
        if self._device.lost and self._semaphore is not None:
            self.cuda.signal_now(self._semaphore, self._value)  # or streams would wait for ever for what isn't written
        self._end()


def shared_timeline(device: WorkQueue, cuda: Cuda, undo: ExitStack) -> tuple[raw.CData, raw.CData]:
    """A timeline semaphore, and CUDA's handle of it."""
    export = raw.struct("VkExportSemaphoreCreateInfo", handleTypes=_SEMAPHORE_FD)
    kind = raw.struct("VkSemaphoreTypeCreateInfo", pNext=export, semaphoreType=raw.VK_SEMAPHORE_TYPE_TIMELINE)
    timeline = device.create("VkSemaphore", raw.struct("VkSemaphoreCreateInfo", pNext=kind), "tensors")
    undo.callback(lambda: device.vk.vkDestroySemaphore(device.handle, timeline, raw.NULL))
    info = raw.struct("VkSemaphoreGetFdInfoKHR", semaphore=timeline, handleType=_SEMAPHORE_FD)
    fd = raw.ffi.new("int*")
    device.vk.vkGetSemaphoreFdKHR(device.handle, info, fd)
    semaphore = cuda.import_timeline(fd[0])
    undo.callback(lambda: cuda.destroy_semaphore(semaphore))
    return timeline, semaphore


def pci_address(device: WorkQueue) -> str:
    """Where a device is on the bus. Raises DeviceError for one that doesn't say it."""
    bus = raw.struct("VkPhysicalDevicePCIBusInfoPropertiesEXT")
    if PCI not in device.offered_extensions:
        raise DeviceError(f"{device.name} lacks {PCI}")
    device.instance_vk.vkGetPhysicalDeviceProperties2(
        device.physical_device, raw.struct("VkPhysicalDeviceProperties2", pNext=bus)
    )
    return f"{bus.pciDomain:04x}:{bus.pciBus:02x}:{bus.pciDevice:02x}.{bus.pciFunction:x}"
