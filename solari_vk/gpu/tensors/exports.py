"""Copies of what was rendered, on the device, that CUDA's libraries take as tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.submission import SemaphoreValue
from solari_vk.gpu.device.work_queue import WorkQueue
from solari_vk.gpu.tensors import dlpack, shared_memory
from solari_vk.gpu.tensors.cuda import Cuda, Hip
from solari_vk.gpu.tensors.shared_memory import MEMORY, SEMAPHORE, Lease, Pool, SharedBuffer

AMD = 0x1002  # the vendor's number at PCI-SIG
NO_SYNC = -1  # DLPack: the consumer takes care


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
        lease: Lease[SharedBuffer],
        await_written: Callable[[int | None], None],
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
    ) -> None:
        self.shape = shape
        self.dtype = dtype
        self._lease = lease
        self._await_written = await_written

    def reshape(self, *shape: int) -> CudaTensor:
        """The same memory as a tensor of another shape."""
        if math.prod(shape) != math.prod(self.shape):
            raise SolariError(f"a tensor of the shape {self.shape} can't have the shape {shape}")
        return CudaTensor(self._lease, self._await_written, shape, self.dtype)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._lease.memory.cuda.dlpack_type, self._lease.memory.cuda.ordinal

    def __dlpack__(self, *, stream: int | None = None, **_: Any) -> Any:
        """A capsule. stream: the consumer's, as the array API standard has it. For -1, which names none, the host waits
        until the tensor is written, and before its memory is used again for all streams."""
        lease = self._lease
        # None and 0 are the default stream by the array API standard.
        reader = None if stream == NO_SYNC else int(stream or 0)
        self._await_written(reader)
        return dlpack.capsule(
            lease.memory.memory.address,
            self.shape,
            self.dtype,
            self.__dlpack_device__(),
            lambda: lease.memory.end_reads(reader),
        )

    def __repr__(self) -> str:
        cuda = self._lease.memory.cuda
        return f"<CudaTensor {self.shape} {self.dtype} on {cuda.name} device {cuda.ordinal}>"


class TensorExports:
    """Makes tensors of a device. Raises DeviceError, with the reason, for a device that neither CUDA nor HIP shares."""

    def __init__(self, device: WorkQueue, memory: Allocator) -> None:
        driver: type[Cuda] = Hip if device.properties.vendor_id == AMD else Cuda
        needed = (MEMORY, SEMAPHORE) if driver.waits_for_timelines else (MEMORY,)
        missing = [name for name in needed if name not in device.extensions]
        if missing:
            raise DeviceError(f"{device.name} lacks {' and '.join(missing)}")
        self._device = device
        self.memory = memory
        # CUDA names devices by their UUID as Vulkan does. HIP's UUIDs are others, but it finds PCI addresses.
        self.cuda = driver(device.properties.uuid if driver is Cuda else shared_memory.pci_address(device))
        self._value = 0
        self._pool = Pool(device, partial(SharedBuffer, device, memory, self.cuda))
        self._timeline = self._semaphore = None
        with ExitStack() as undo:
            undo.callback(self.cuda.close)
            if driver.waits_for_timelines:
                self._timeline, self._semaphore = shared_memory.shared_timeline(device, self.cuda, undo)
            undo.callback(self._pool.close)
            self._end = undo.pop_all().close
        device.share(device.register(self._close))

    def export(
        self, record_copy: Callable[[raw.CData, raw.CData], None], shape: tuple[int, ...], dtype: np.dtype[Any]
    ) -> CudaTensor:
        """A tensor of what `record_copy(command buffer, VkBuffer)` copies. uint32 becomes int32, since few libraries
        compute with it: 2^32 - 1, of no instance, is -1."""
        device = self._device
        buffer = self._pool.acquire(math.prod(shape) * dtype.itemsize)
        # An earlier tensor may have lain here, whose last readers in CUDA must be done before Vulkan writes.
        buffer.await_consumers()
        if dtype == np.uint32:
            dtype = np.dtype(np.int32)

        def record(cmd: raw.CData) -> None:
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            record_copy(cmd, buffer.handle)
            device.vk.vkCmdPipelineBarrier2(cmd, buffer.to_cuda)

        device.start_with_next(record, "tensor")
        await_written = self.submit([])
        return CudaTensor(self._pool.lend(buffer, buffer.size), await_written, shape, dtype)

    def submit(
        self, commands: Sequence[raw.CData], waits: Sequence[SemaphoreValue] = ()
    ) -> Callable[[int | None], None]:
        """Submit command buffers, which wait for semaphores. Returns what has a stream wait for them, or, with None and
        where streams can't, the host."""
        device = self._device
        value = self._value + 1
        # Where streams can wait for timelines, Vulkan signals one; else the host waits.
        signals = [] if self._timeline is None else [(self._timeline, value)]
        submitted = device.submit_prepared(device.submission(commands, waits, signals))
        self._value = value

        def wait(stream: int | None) -> None:
            if self._semaphore is None or stream is None:
                device.await_value(submitted)
            else:
                self.cuda.wait(self._semaphore, value, stream)

        return wait

    def _close(self) -> None:
        if self._device.lost and self._semaphore is not None:
            # Streams of CUDA would wait for ever for work that a lost device never does.
            self.cuda.signal_now(self._semaphore, self._value)
        self._end()
