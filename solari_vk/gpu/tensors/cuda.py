"""CUDA's driver, libcuda, as far as memory and semaphores of Vulkan are imported (CUDA driver API 12, group "External
Resource Interoperability"), which comes with NVIDIA's driver; and the same of HIP, libamdhip64, which comes with ROCm's
PyTorch. HIP's functions and structures are CUDA's by other names."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, ClassVar

from cffi import FFI

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.tensors import dlpack
from solari_vk.gpu.tensors.cuda_header import HEADER
from solari_vk.gpu.tensors.cuda_header import HIP as _HIP

# CU_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD, CU_EXTERNAL_SEMAPHORE_HANDLE_TYPE_TIMELINE_SEMAPHORE_FD and
# CUDA_EXTERNAL_MEMORY_DEDICATED, which must be set for a dedicated allocation of Vulkan.
_OPAQUE_FD = 1
_TIMELINE_FD = 9
_DEDICATED = 1
_ffi: Any = FFI()
_ffi.cdef(HEADER)
_ffi.cdef("int hipDeviceGetByPCIBusId(CUdevice *, const char *);")
# HIP's functions have CUDA's signatures: the same declarations by other names.
for _line in HEADER.split("\n"):
    _name = _line.partition("(")[0].removeprefix("int ")
    if _name in _HIP:
        _ffi.cdef(_line.replace(_name, _HIP[_name]))
_NO_TIMING = 2  # CU_EVENT_DISABLE_TIMING, with which events cost least
_STILL_WELL = {600, *range(900, 909)}  # of cuStreamQuery: work isn't done, or a graph is being captured
_NON_BLOCKING = 1  # a stream that doesn't wait for the default one
CData = Any


class Cuda:
    """The CUDA device that is the Vulkan device of a UUID, with its primary context, which PyTorch, CuPy and JAX use.

    Raises DeviceError without a driver of CUDA, and if CUDA doesn't show the device.
    """

    name = "CUDA"
    libraries: tuple[str, ...] = ("libcuda.so.1",)
    dlpack_type = dlpack.CUDA
    default_stream = 1  # by DLPack's numbers
    waits_for_timelines = True
    """Whether streams wait for timeline semaphores of Vulkan."""
    names: ClassVar[dict[str, str]] = {}

    def __init__(self, identity: str) -> None:
        self._lib = self._opened()
        self.call("cuInit", 0)
        self.ordinal = self._find(identity)
        """The device's number in CUDA."""
        # The primary context is the one that CUDA's runtime uses, and so PyTorch, CuPy and JAX: their addresses and
        # streams are valid in it.
        context = _ffi.new("CUcontext *")
        self.call("cuDevicePrimaryCtxRetain", context, self._handle(self.ordinal))
        self._context = context[0]

    def _opened(self) -> Any:
        for library in self.libraries:
            try:
                return _ffi.dlopen(library)
            except OSError as error:
                reason = error
        raise DeviceError(f"{self.name}'s library can't be opened: {reason}")

    def _find(self, identity: str) -> int:
        """The number of the device with a UUID."""
        count = _ffi.new("int *")
        self.call("cuDeviceGetCount", count)
        # CUDA_VISIBLE_DEVICES renumbers and hides devices, so numbers of CUDA and Vulkan can't be compared.
        ordinal = next((i for i in range(count[0]) if self._uuid(i) == identity), None)
        if ordinal is None:
            raise DeviceError(f"CUDA shows no device with the UUID {identity}: see CUDA_VISIBLE_DEVICES")
        return ordinal

    def _function(self, name: str) -> Any:
        name = self.names.get(name, name)
        try:
            return getattr(self._lib, name)
        except AttributeError:
            raise DeviceError(f"{self.name}'s library is too old: it has no {name}") from None

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver by its name in CUDA. Raises DeviceError with its name and the reason."""
        # cuStreamQuery also reports work that isn't done, and captures, which are no failures.
        result = self._function(name)(*arguments)
        if result and not (name == "cuStreamQuery" and result in _STILL_WELL):
            text = _ffi.new("const char **")
            self._function("cuGetErrorString")(result, text)
            reason = _ffi.string(text[0]).decode() if text[0] != _ffi.NULL else f"error {result}"
            raise DeviceError(f"{self.names.get(name, name)}: {reason}")

    @contextmanager
    def current(self) -> Iterator[None]:
        """Have the context current in this thread."""
        # Each thread has a stack of contexts; a library's own context must be on top again afterwards.
        self.call("cuCtxPushCurrent_v2", self._context)
        try:
            yield
        finally:
            self.call("cuCtxPopCurrent_v2", _ffi.new("CUcontext *"))

    def free(self, name: str, *arguments: Any) -> None:
        """Call a function that frees something. A context that has failed frees nothing until the process ends."""
        with suppress(DeviceError), self.current():
            self.call(name, *arguments)

    def check(self) -> None:
        """Raise DeviceError if the context has failed, as after a kernel that writes out of bounds."""
        with self.current():
            self.call("cuStreamQuery", _ffi.cast("CUstream", self.default_stream))

    def close(self) -> None:
        """Give the context back."""
        with suppress(DeviceError):
            self.call("cuDevicePrimaryCtxRelease_v2", self._handle(self.ordinal))

    def import_timeline(self, fd: int) -> CData:
        """A timeline semaphore, whose file descriptor then belongs to CUDA."""
        semaphore = _ffi.new("CUexternalSemaphore *")
        with closed_on_error(fd), self.current():
            self.call(
                "cuImportExternalSemaphore",
                semaphore,
                _ffi.new("CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC *", {"type": _TIMELINE_FD, "handle": {"fd": fd}}),
            )
        return semaphore[0]

    def destroy_semaphore(self, semaphore: CData) -> None:
        self.free("cuDestroyExternalSemaphore", semaphore)

    def wait(self, semaphore: CData, value: int, stream: int) -> None:
        """Have the work that a stream gets from now on wait until a timeline semaphore has a value."""
        wait = _ffi.new("CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS *", {"params": {"value": value}})
        with self.current():
            self.call(
                "cuWaitExternalSemaphoresAsync",
                _ffi.new("CUexternalSemaphore *", semaphore),
                wait,
                1,
                _ffi.cast("CUstream", stream),
            )

    def signal(self, semaphore: CData, value: int, stream: int) -> None:
        """Have a timeline semaphore get a value when the work that a stream has now is done."""
        signal = _ffi.new("CUDA_EXTERNAL_SEMAPHORE_SIGNAL_PARAMS *", {"params": {"value": value}})
        with self.current():
            self.call(
                "cuSignalExternalSemaphoresAsync",
                _ffi.new("CUexternalSemaphore *", semaphore),
                signal,
                1,
                _ffi.cast("CUstream", stream),
            )

    def signal_now(self, semaphore: CData, value: int) -> None:
        """Give a timeline semaphore a value now, whatever other streams wait for."""
        # A non-blocking stream: the default one may wait for work that waits for this signal.
        stream = _ffi.new("CUstream *")
        with self.current():
            self.call("cuStreamCreate", stream, _NON_BLOCKING)
            try:
                self.signal(semaphore, value, int(_ffi.cast("intptr_t", stream[0])))
            finally:
                self.call("cuStreamDestroy_v2", stream[0])  # when its work is done

    def copy(self, target: int, source: int, size: int, stream: int) -> None:
        """Have a stream copy bytes from one address of the device to another."""
        with self.current():
            self.call("cuMemcpyDtoDAsync_v2", target, source, size, _ffi.cast("CUstream", stream))

    def await_stream(self, stream: int) -> None:
        """Wait on the host for the work that a stream has now."""
        with self.current():
            self.call("cuStreamSynchronize", _ffi.cast("CUstream", stream))

    def synchronize(self) -> None:
        """Wait on the host for the work that all streams have now."""
        with self.current():
            self.call("cuCtxSynchronize")

    def _handle(self, ordinal: int) -> int:
        handle = _ffi.new("CUdevice *")
        self.call("cuDeviceGet", handle, ordinal)
        return int(handle[0])

    def _uuid(self, ordinal: int) -> str:
        found = _ffi.new("CUuuid *")
        self.call("cuDeviceGetUuid_v2", found, self._handle(ordinal))
        return str(uuid.UUID(bytes=bytes(_ffi.buffer(found))))


class Hip(Cuda):
    """The HIP device at the Vulkan device's PCI address, such as 0000:03:00.0.

    Its streams don't wait for timeline semaphores of Vulkan (ROCm's own tests leave them out). Written after its
    documentation; no AMD device has run it.
    """

    name = "HIP"
    libraries = ("libamdhip64.so.7", "libamdhip64.so.6", "libamdhip64.so.5", "libamdhip64.so")
    dlpack_type = dlpack.ROCM
    default_stream = 0
    waits_for_timelines = False
    names: ClassVar[dict[str, str]] = _HIP

    def _find(self, identity: str) -> int:
        ordinal = _ffi.new("CUdevice *")
        try:
            self.call("hipDeviceGetByPCIBusId", ordinal, identity.encode())
        except DeviceError as error:
            raise DeviceError(
                f"HIP shows no device at the PCI address {identity}: see HIP_VISIBLE_DEVICES; {error}"
            ) from None
        return int(ordinal[0])


@contextmanager
def closed_on_error(fd: int) -> Iterator[None]:
    """Close a file descriptor that an error leaves to its maker."""
    try:
        yield
    except BaseException:
        os.close(fd)
        raise


class CudaMemory:
    """Memory of `size` bytes that CUDA imports from a file descriptor, which then belongs to CUDA. `address` is its
    pointer. `allocated`: the bytes of the dedicated allocation of Vulkan."""

    def __init__(self, cuda: Cuda, fd: int, allocated: int, size: int) -> None:
        self._cuda = cuda
        memory = _ffi.new("CUexternalMemory *")
        pointer = _ffi.new("CUdeviceptr *")
        with closed_on_error(fd), cuda.current():
            cuda.call(
                "cuImportExternalMemory",
                memory,
                _ffi.new(
                    "CUDA_EXTERNAL_MEMORY_HANDLE_DESC *",
                    {"type": _OPAQUE_FD, "handle": {"fd": fd}, "size": allocated, "flags": _DEDICATED},
                ),
            )
        self._memory = memory[0]
        with cuda.current():
            try:
                cuda.call(
                    "cuExternalMemoryGetMappedBuffer",
                    pointer,
                    self._memory,
                    _ffi.new("CUDA_EXTERNAL_MEMORY_BUFFER_DESC *", {"size": size}),
                )
            except BaseException:
                cuda.call("cuDestroyExternalMemory", self._memory)
                raise
        self.address = int(pointer[0])

    def close(self) -> None:
        # A mapped buffer must be freed before the memory that it maps.
        self._cuda.free("cuMemFree_v2", _ffi.cast("CUdeviceptr", self.address))
        self._cuda.free("cuDestroyExternalMemory", self._memory)


class CudaEvent:
    """A point in a stream's work."""

    def __init__(self, cuda: Cuda) -> None:
        self._cuda = cuda
        event = _ffi.new("CUevent *")
        with cuda.current():
            cuda.call("cuEventCreate", event, _NO_TIMING)
        self._event = event[0]

    def record(self, stream: int) -> None:
        """Set the point behind the work that a stream has now."""
        with self._cuda.current():
            self._cuda.call("cuEventRecord", self._event, _ffi.cast("CUstream", stream))

    def wait(self) -> None:
        """Wait on the host until the point is reached; at once if none was set."""
        with self._cuda.current():
            self._cuda.call("cuEventSynchronize", self._event)

    def close(self) -> None:
        self._cuda.free("cuEventDestroy_v2", self._event)
