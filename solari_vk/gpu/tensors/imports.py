"""Tensors of CUDA's libraries that are copied to memory of the device."""

from __future__ import annotations

import math
import sys
import weakref
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.work_queue import WorkQueue
from solari_vk.gpu.tensors import dlpack, shared_memory
from solari_vk.gpu.tensors.exports import NO_SYNC, TensorExports
from solari_vk.gpu.tensors.shared_memory import Lease, Pool, SharedBuffer

FLOATS = (np.float32, np.float64)


class _Staging:
    """How tensors of one size reach the device: a staging buffer that CUDA writes, a buffer of the device's own, and
    commands that copy from one to the other. What CUDA maps is for copies alone: shaders have no address of it."""

    def __init__(self, shared: SharedBuffer, buffer: Buffer, copying: Recorded) -> None:
        self.shared = shared
        self.buffer = buffer
        self.copying = copying
        self.await_read: Callable[[int | None], None] = _do_nothing
        """Has a stream wait until the latest tensor was copied from the staging buffer."""
        self.tensors = weakref.WeakSet[DeviceTensor]()

    def close(self) -> None:
        """Free it."""
        self.copying.destroy()
        self.shared.close()
        self.buffer.destroy()


class DeviceTensor:
    """A copy of a tensor, or a part of it, in memory of the device. shape, dtype: as of numpy arrays. `address` is that
    of the first number, `strides` are in bytes.

    The memory is used again when the last object that shows it is gone. When the device is closed, the numbers move to
    the host's memory.
    """

    def __init__(
        self,
        lease: Lease[_Staging],
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
        strides: tuple[int, ...],
        begin: int = 0,
    ) -> None:
        self.shape = shape
        self.dtype = dtype
        self.strides = strides
        self._lease: Lease[_Staging] | None = lease  # None after the device was closed
        self._begin = begin
        self._on_host: NDArray[Any] | None = None
        lease.memory.tensors.add(self)

    @property
    def device(self) -> WorkQueue | None:
        """None after it was closed."""
        return None if self._lease is None else self._buffer.device

    @property
    def address(self) -> int:
        return self._buffer.address + self._begin

    @property
    def _buffer(self) -> Buffer:
        return self._open_lease.memory.buffer

    @property
    def _open_lease(self) -> Lease[_Staging]:
        if self._lease is None:
            raise DeviceError("a tensor was given to a device that is closed: give it again")
        return self._lease

    def at(self, index: int, axis: int = 0) -> DeviceTensor:
        """The part at an index along an axis, in the same memory."""
        begin = self._begin + index * self.strides[axis]
        shape = (*self.shape[:axis], *self.shape[axis + 1 :])
        strides = (*self.strides[:axis], *self.strides[axis + 1 :])
        return DeviceTensor(self._open_lease, shape, self.dtype, strides, begin)

    def read(self) -> NDArray[Any]:
        """The numbers in the host's memory, floats as float64. Waits for all work submitted so far."""
        if self._on_host is not None:
            return self._on_host.copy()
        # The whole buffer is read: a part may lie anywhere in it, with gaps.
        values = np.ndarray(self.shape, self.dtype, self._buffer.read(), self._begin, self.strides)
        return values.astype(np.float64 if self.dtype.kind == "f" else self.dtype)

    def move_to_host(self) -> None:
        """Have the numbers in the host's memory alone, or nowhere if the device is lost."""
        try:
            self._on_host = self.read()
        finally:
            self._lease = None


class TensorImports:
    """Copies tensors of CUDA to a device. make: a buffer of so many bytes with a name, which is the device's own."""

    def __init__(self, exports: TensorExports, device: WorkQueue, make: Callable[..., Buffer]) -> None:
        self._exports = exports
        self._device = device
        self._make = make
        self._staging = weakref.WeakSet[_Staging]()
        self._pool = Pool(device, self._new_staging)
        self._value = 0  # of the timeline: the latest that a stream will signal
        self._timeline = self._semaphore = None
        with ExitStack() as undo:
            if exports.cuda.waits_for_timelines:
                self._timeline, self._semaphore = shared_memory.shared_timeline(device, exports.cuda, undo)
                device.late.append(self._check_cuda)
            undo.callback(self._pool.close)
            device.share(device.register(undo.pop_all().close))

    def accept(self, value: Any, dtypes: Sequence[Any] = FLOATS) -> DeviceTensor | None:
        """A copy of a tensor as it is when the work is done that its stream has now. Neither the host nor later work of
        the stream waits, but with HIP the host. None for a tensor of another device, or of numbers that aren't of these
        dtypes in one piece of memory."""
        if self._device.closed:
            raise DeviceError(f"{self._device.name} {self._device.closed_how}")
        cuda = self._exports.cuda
        if tuple(map(int, value.__dlpack_device__())) != (cuda.dlpack_type, cuda.ordinal):
            return None
        if hasattr(value, "detach") and hasattr(value, "contiguous"):  # PyTorch
            value = value.detach().contiguous()
        # Where the library's stream is known, the copy goes to that stream and needs no order with others. Else the
        # library makes the default stream wait for its own work, as DLPack has it for the `stream` of a consumer.
        known = _stream_of(value)
        stream = cuda.default_stream if known is None else known
        capsule = value.__dlpack__(stream=stream if known is None else NO_SYNC)
        source, shape, dtype = dlpack.described(capsule)
        if dtype is None or dtype not in dtypes or not source:
            return None
        size = math.prod(shape) * dtype.itemsize
        room = -(-size // 4) * 4  # shaders read bytes by four
        staging = self._pool.acquire(room)
        try:
            staging.await_read(stream)
            cuda.copy(staging.shared.memory.address, source, size, stream)
            staging.await_read = self._exports.submit([staging.copying.commands], self._after(stream))
        except BaseException:
            self._pool.give_back(staging, room)
            raise
        self._device.retire(partial(_do_nothing, capsule))  # holds the library's memory until the copy is done
        return DeviceTensor(self._pool.lend(staging, room), shape, dtype, np.empty(shape, dtype).strides)

    def move_to_host(self) -> None:
        """Have all tensors that anybody still has in the host's memory: the device is about to be closed."""
        tensors = [tensor for staging in self._staging for tensor in staging.tensors]
        for tensor in tensors:
            with suppress(DeviceError):
                tensor.move_to_host()

    def _check_cuda(self) -> None:
        """Raise DeviceError if CUDA has failed, after which streams signal nothing: work must not wait for them."""
        device = self._device
        reached = raw.ffi.new("uint64_t*")
        device.vk.vkGetSemaphoreCounterValue(device.handle, self._timeline, reached)
        if reached[0] >= self._value:
            return
        try:
            self._exports.cuda.check()
        except DeviceError as error:
            # The host signals in the stream's place, so that submitted work ends and the device stays usable.
            info = raw.struct("VkSemaphoreSignalInfo", semaphore=self._timeline, value=self._value)
            device.vk.vkSignalSemaphore(device.handle, info)
            raise DeviceError(f"CUDA failed, so that tensors given to {device.name} are lost: {error}") from None

    def _after(self, stream: int) -> Sequence[Any]:
        """What a submission waits for to come after the work that a stream has now."""
        cuda = self._exports.cuda
        if self._semaphore is None:
            cuda.await_stream(stream)
            return ()
        if self._value:
            # A timeline's values must rise, whichever stream sets them: this stream waits for the one before.
            cuda.wait(self._semaphore, self._value, stream)
        cuda.signal(self._semaphore, self._value + 1, stream)
        self._value += 1
        return ((self._timeline, self._value),)

    def _new_staging(self, size: int) -> _Staging:
        device = self._device
        with ExitStack() as undo:
            buffer = self._make(size, "tensor", shared=True)
            undo.callback(buffer.destroy)
            shared = SharedBuffer(device, self._exports.memory, self._exports.cuda, size)
            undo.callback(shared.close)

            def record(cmd: raw.CData) -> None:
                # Vulkan owns the staging buffer during its copy alone: CUDA writes the next tensor to it.
                device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
                device.vk.vkCmdPipelineBarrier2(cmd, shared.from_cuda)
                region = raw.struct("VkBufferCopy", size=size)
                device.vk.vkCmdCopyBuffer(cmd, shared.handle, buffer.handle, 1, region)
                device.vk.vkCmdPipelineBarrier2(cmd, shared.to_cuda)
                device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

            staging = _Staging(shared, buffer, Recorded(device, record, "accept tensor"))
            undo.pop_all()
        self._staging.add(staging)
        return staging


def _stream_of(value: Any) -> int | None:
    """The stream in which a library works now, None where that isn't known. What is given later to this stream may
    change the tensor, and is behind the copy."""
    # A user's subclass of a library's tensor has the library among its bases.
    libraries = {kind.__module__.partition(".")[0] for kind in type(value).__mro__}
    module: Any
    if "torch" in libraries:
        module = sys.modules["torch"]
        return int(module.cuda.current_stream(value.device).cuda_stream)
    if "cupy" in libraries:
        module = sys.modules["cupy"]
        return int(module.cuda.get_current_stream().ptr)
    return None


def _do_nothing(_: Any) -> None:
    pass
