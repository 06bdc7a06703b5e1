"""Tensors of CUDA's libraries that are given to the device, and copied on it."""

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
from solari_vk.gpu.device import cuda_tensor, dlpack, raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_tensor import NO_SYNC, CudaTensors, Place
from solari_vk.gpu.device.places import Lease, Places
from solari_vk.gpu.device.recorded import Recorded
from solari_vk.gpu.device.work_queue import WorkQueue

FLOATS = (np.float32, np.float64)


class _Way:
    """How tensors of one size reach the device: memory that CUDA writes, a buffer of the device's own, and the commands
    that copy from one to the other."""

    def __init__(self, place: Place, buffer: Buffer, copying: Recorded) -> None:
        self.place, self.buffer, self.copying = place, buffer, copying
        self.await_read: Callable[[int | None], None] = _do_nothing
        """Has a stream wait until the latest tensor was copied to the buffer."""
        self.taken = weakref.WeakSet[Taken]()

    def close(self) -> None:
        """Free it."""
        self.copying.destroy()
        self.place.close()
        self.buffer.destroy()


class Taken:
    """A copy of a tensor, or a part of it, in memory of the device. shape, dtype: as of numpy arrays. `address` is that
    of the first number, `strides` are in bytes."""

    def __init__(
        self, lease: Lease[_Way], shape: tuple[int, ...], dtype: np.dtype[Any], strides: tuple[int, ...], begin: int = 0
    ) -> None:
        self.shape, self.dtype, self.strides = shape, dtype, strides
        self._lease: Lease[_Way] | None = lease
        self._begin = begin
        self._on_host: NDArray[Any] | None = None
        lease.place.taken.add(self)

    @property
    def device(self) -> WorkQueue | None:
        """None after it was closed."""
        return None if self._lease is None else self._buffer.device

    @property
    def address(self) -> int:
        return self._buffer.address + self._begin

    @property
    def _buffer(self) -> Buffer:
        return self._held.place.buffer

    @property
    def _held(self) -> Lease[_Way]:
        if self._lease is None:
            raise DeviceError("a tensor was given to a device that is closed: give it again")
        return self._lease

    def at(self, index: int, axis: int = 0) -> Taken:
        """The part at an index along an axis, in the same memory."""
        begin = self._begin + index * self.strides[axis]
        shape, strides = ((*given[:axis], *given[axis + 1 :]) for given in (self.shape, self.strides))
        return Taken(self._held, shape, self.dtype, strides, begin)

    def copy(self) -> NDArray[Any]:
        """The numbers in the host's memory, floats as float64. Waits for all work submitted so far."""
        if self._on_host is not None:
            return self._on_host.copy()
        values = np.ndarray(self.shape, self.dtype, self._buffer.read(), self._begin, self.strides)
        return values.astype(np.float64 if self.dtype.kind == "f" else self.dtype)

    def keep_on_host(self) -> None:
        """Have the numbers in the host's memory alone, or nowhere if the device is lost."""
        try:
            self._on_host = self.copy()
        finally:
            self._lease = None


class CudaInputs:
    """Takes tensors of a device's CUDA. make: a buffer of so many bytes with a name, which is the device's own."""

    def __init__(self, tensors: CudaTensors, device: WorkQueue, make: Callable[..., Buffer]) -> None:
        self._tensors, self._device, self._make = tensors, device, make
        self._ways = weakref.WeakSet[_Way]()
        self._places = Places(device, self._new)
        self._value, self._timeline, self._semaphore = 0, None, None
        with ExitStack() as undo:
            if tensors.cuda.waits_for_timelines:
                self._timeline, self._semaphore = cuda_tensor.shared_timeline(device, tensors.cuda, undo)
                device.late.append(self._check_cuda)
            undo.callback(self._places.close)
            device.share(device.own(undo.pop_all().close))

    def take(self, value: Any, dtypes: Sequence[Any] = FLOATS) -> Taken | None:
        """A copy of a tensor as it is when the work is done that its stream has now. Neither the host nor later work of
        the stream waits, but with HIP the host. None for a tensor of another device, or of numbers that aren't of these
        dtypes in one piece of memory."""
        if self._device.closed:
            raise DeviceError(f"{self._device.name} {self._device.closed_how}")
        cuda = self._tensors.cuda
        if tuple(map(int, value.__dlpack_device__())) != (cuda.dlpack_type, cuda.ordinal):
            return None
        if hasattr(value, "detach") and hasattr(value, "contiguous"):  # PyTorch
            value = value.detach().contiguous()
        known = _stream_of(value)
        stream = cuda.default_stream if known is None else known
        capsule = value.__dlpack__(stream=stream if known is None else NO_SYNC)
        source, shape, dtype = dlpack.described(capsule)
        if dtype is None or dtype not in dtypes or not source:
            return None
        strides = np.empty(shape, dtype).strides
        size = math.prod(shape) * dtype.itemsize
        room = -(-size // 4) * 4  # shaders read bytes by four
        way = self._places.take(room)
        try:
            way.await_read(stream)
            cuda.copy(way.place.memory.address, source, size, stream)
            way.await_read = self._tensors.submit(way.copying.commands, self._after(stream))
        except BaseException:
            self._places.give_back(way, room)
            raise
        self._device.retire(partial(_do_nothing, capsule))  # its memory, when the copy is done
        return Taken(self._places.lend(way, room), shape, dtype, strides)

    def keep_on_host(self) -> None:
        """Have what is taken, and what anybody still has, in the host's memory: the device is about to be closed."""
        for taken in [taken for way in self._ways for taken in way.taken]:
            with suppress(DeviceError):
                taken.keep_on_host()

    def _check_cuda(self) -> None:
        """Raise DeviceError if CUDA has failed, after which streams signal nothing: work must not wait for them."""
        device = self._device
        reached = raw.ffi.new("uint64_t*")
        device.vk.vkGetSemaphoreCounterValue(device.handle, self._timeline, reached)
        if reached[0] >= self._value:
            return
        try:
            self._tensors.cuda.check()
        except DeviceError as error:
            info = raw.struct("VkSemaphoreSignalInfo", semaphore=self._timeline, value=self._value)
            device.vk.vkSignalSemaphore(device.handle, info)
            raise DeviceError(f"CUDA failed, so that tensors given to {device.name} are lost: {error}") from None

    def _after(self, stream: int) -> Sequence[Any]:
        """What a submission waits for to come after the work that a stream has now."""
        cuda = self._tensors.cuda
        if self._semaphore is None:
            cuda.await_stream(stream)
            return ()
        if self._value:
            cuda.wait(self._semaphore, self._value, stream)  # values must rise, whichever stream sets them
        cuda.signal(self._semaphore, self._value + 1, stream)
        self._value += 1
        return ((self._timeline, self._value),)

    def _new(self, size: int) -> _Way:
        device, tensors = self._device, self._tensors
        with ExitStack() as undo:
            buffer = self._make(size, "given tensor", shared=True)
            undo.callback(buffer.destroy)
            place = Place(device, tensors.memory, tensors.cuda, size)
            undo.callback(place.close)

            def record(cmd: raw.CData) -> None:
                device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
                device.vk.vkCmdPipelineBarrier2(cmd, place.from_cuda)
                region = raw.struct("VkBufferCopy", size=size)
                device.vk.vkCmdCopyBuffer(cmd, place.handle, buffer.handle, 1, region)
                device.vk.vkCmdPipelineBarrier2(cmd, place.to_cuda)
                device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

            way = _Way(place, buffer, Recorded(device, record, "take tensor"))
            undo.pop_all()
        self._ways.add(way)
        return way


def _stream_of(value: Any) -> int | None:
    """The stream in which a library works now, None where that isn't known. What is given later to this stream may
    change the tensor, and is behind the copy."""
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
