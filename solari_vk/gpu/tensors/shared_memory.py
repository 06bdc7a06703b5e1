"""Memory and semaphores that Vulkan exports and CUDA imports, and pools of such memory.

Vulkan exports file descriptors (VK_KHR_external_memory_fd, VK_KHR_external_semaphore_fd). Ownership of a buffer passes
between the two by barriers to and from VK_QUEUE_FAMILY_EXTERNAL.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Generic, Protocol, TypeVar

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import ALL_COMMANDS, READ, WRITE
from solari_vk.gpu.device.work_queue import WorkQueue
from solari_vk.gpu.tensors.cuda import Cuda, CudaEvent, CudaMemory

MEMORY = "VK_KHR_external_memory_fd"
SEMAPHORE = "VK_KHR_external_semaphore_fd"
PCI = "VK_EXT_pci_bus_info"
_FD = raw.VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT
_SEMAPHORE_FD = raw.VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT
_UNUSED_OF_A_SIZE = 2
_USAGE = raw.VK_BUFFER_USAGE_TRANSFER_DST_BIT | raw.VK_BUFFER_USAGE_TRANSFER_SRC_BIT


class SharedBuffer:
    """A buffer in memory that CUDA maps too, and the work of CUDA that may still read it."""

    def __init__(self, device: WorkQueue, memory: Allocator, cuda: Cuda, size: int) -> None:
        self.size = size
        self.cuda = cuda
        self._device = device
        self._events: list[CudaEvent] = []  # consumers' work that may still read
        self._read_anywhere = False  # a consumer may have read in any stream
        # Buffer and memory must both say for what they will be exported, before they are made.
        external = raw.struct("VkExternalMemoryBufferCreateInfo", handleTypes=_FD)
        create = raw.struct("VkBufferCreateInfo", pNext=external, size=size, usage=_USAGE)
        vk = device.vk
        with ExitStack() as undo:
            self.handle = device.create("VkBuffer", create, "tensor")
            undo.callback(lambda: vk.vkDestroyBuffer(device.handle, self.handle, raw.NULL))
            requirements = raw.ffi.new("VkMemoryRequirements*")
            vk.vkGetBufferMemoryRequirements(device.handle, self.handle, requirements)
            # A dedicated allocation: CUDA imports it as a whole, and knows it by its flag.
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
            # CUDA owns the file descriptor as soon as the import succeeds, and closes it.
            fd = raw.ffi.new("int*")
            info = raw.struct("VkMemoryGetFdInfoKHR", memory=allocated[0], handleType=_FD)
            vk.vkGetMemoryFdKHR(device.handle, info, fd)
            self.memory = CudaMemory(cuda, fd[0], int(requirements.size), size)
            undo.callback(self.memory.close)
            self._free = undo.pop_all().close

    def close(self) -> None:
        """Free it when no work reads it any more."""
        with suppress(DeviceError):  # a context that has failed runs no work any more
            self.await_consumers()
        self._free()

    @property
    def to_cuda(self) -> raw.CData:
        """The barrier after which CUDA owns the buffer. What it held isn't asked for when Vulkan writes again."""
        return self._ownership_transfer(self._device.queue_family, raw.VK_QUEUE_FAMILY_EXTERNAL)

    @property
    def from_cuda(self) -> raw.CData:
        """The barrier after which Vulkan owns the buffer, with what CUDA wrote."""
        return self._ownership_transfer(raw.VK_QUEUE_FAMILY_EXTERNAL, self._device.queue_family)

    def _ownership_transfer(self, source: int, target: int) -> raw.CData:
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

    def end_reads(self, stream: int | None) -> None:
        """Remember the work that a stream has now, of any stream for None, as the last that reads. Any thread may call
        this."""
        if stream is None:
            self._read_anywhere = True
            return
        # The consumer has enqueued its last read; an event behind it tells when the memory is free.
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


class Closable(Protocol):
    """What a `Pool` lends."""

    def close(self) -> None: ...


Memory = TypeVar("Memory", bound=Closable)


class Lease(Generic[Memory]):
    """A use of memory, until this object is gone."""

    def __init__(self, memory: Memory) -> None:
        self.memory = memory


class Pool(Generic[Memory]):
    """Memory that stays for later users who need the same size, of which two unused ones are kept. make: memory of so
    many bytes."""

    def __init__(self, device: WorkQueue, make: Callable[[int], Memory]) -> None:
        self._device = device
        self._make = make
        self._unused = defaultdict[int, deque[Memory]](deque)

    @property
    def unused_count(self) -> int:
        return sum(map(len, self._unused.values()))

    def acquire(self, size: int) -> Memory:
        """Memory that the caller passes to `lend`, or to `give_back`."""
        self._device.collect()
        unused = self._unused[size]
        # The one that has been unused for longest, which all work has most likely left.
        return unused.popleft() if unused else self._make(size)

    def lend(self, memory: Memory, size: int) -> Lease[Memory]:
        """Have the pool get memory back when the lease is gone. Any thread may drop it."""
        lease = Lease(memory)
        self._device.loans.lend(lease, partial(self.give_back, memory, size))
        return lease

    def give_back(self, memory: Memory, size: int) -> None:
        """Nobody needs this memory any more."""
        unused = self._unused[size]
        unused.append(memory)
        if len(unused) > _UNUSED_OF_A_SIZE and not self._device.closed:
            self._device.retire(unused.popleft().close)  # submitted copies may still use it

    def close(self) -> None:
        """Close all that is unused."""
        for unused in self._unused.values():
            while unused:
                unused.popleft().close()


def shared_timeline(device: WorkQueue, cuda: Cuda, undo: ExitStack) -> tuple[raw.CData, raw.CData]:
    """A timeline semaphore, and CUDA's handle of it."""
    # CUDA waits for and signals the same counter as Vulkan, without the host.
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
