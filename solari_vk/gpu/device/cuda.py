"""CUDA's driver, libcuda, as far as memory and semaphores of Vulkan are imported (CUDA driver API 12, group "External
Resource Interoperability"). It comes with NVIDIA's driver, so nothing has to be installed."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cffi import FFI

from solari_vk.errors import DeviceError

_OPAQUE_FD, _TIMELINE_FD, _DEDICATED = 1, 9, 1
_HEADER = """
typedef int CUdevice;
typedef struct { char bytes[16]; } CUuuid;
typedef unsigned long long CUdeviceptr;
typedef void *CUcontext, *CUstream, *CUevent, *CUexternalMemory, *CUexternalSemaphore;
typedef union { int fd; struct { void *handle; void *name; } win32; } Handle;
typedef struct {
    int type; Handle handle; unsigned long long size; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_MEMORY_HANDLE_DESC;
typedef struct {
    unsigned long long offset; unsigned long long size; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_MEMORY_BUFFER_DESC;
typedef struct {
    int type; Handle handle; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC;
typedef struct {
    struct {
        unsigned long long value; unsigned long long nvSciSync;
        struct { unsigned long long key; unsigned timeoutMs; } keyedMutex;
        unsigned reserved[10];
    } params;
    unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS;
int cuInit(unsigned);
int cuGetErrorString(int, const char **);
int cuDeviceGetCount(int *);
int cuDeviceGet(CUdevice *, int);
int cuDeviceGetUuid_v2(CUuuid *, CUdevice);
int cuDevicePrimaryCtxRetain(CUcontext *, CUdevice);
int cuDevicePrimaryCtxRelease_v2(CUdevice);
int cuCtxPushCurrent_v2(CUcontext);
int cuCtxPopCurrent_v2(CUcontext *);
int cuImportExternalMemory(CUexternalMemory *, const CUDA_EXTERNAL_MEMORY_HANDLE_DESC *);
int cuExternalMemoryGetMappedBuffer(CUdeviceptr *, CUexternalMemory, const CUDA_EXTERNAL_MEMORY_BUFFER_DESC *);
int cuDestroyExternalMemory(CUexternalMemory);
int cuMemFree_v2(CUdeviceptr);
int cuImportExternalSemaphore(CUexternalSemaphore *, const CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC *);
int cuWaitExternalSemaphoresAsync(
    const CUexternalSemaphore *, const CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS *, unsigned, CUstream);
int cuDestroyExternalSemaphore(CUexternalSemaphore);
int cuEventCreate(CUevent *, unsigned);
int cuEventRecord(CUevent, CUstream);
int cuEventSynchronize(CUevent);
int cuEventDestroy_v2(CUevent);
int cuMemcpyDtoH_v2(void *, CUdeviceptr, size_t);
"""
_ffi: Any = FFI()
_ffi.cdef(_HEADER)
_NO_TIMING = 2
CData = Any


class Cuda:
    """The CUDA device that is the Vulkan device of a UUID, with its primary context, which PyTorch, CuPy and JAX use.

    Raises DeviceError without a driver of CUDA, and if CUDA doesn't show the device.
    """

    def __init__(self, device_uuid: str) -> None:
        try:
            self._lib = _ffi.dlopen("libcuda.so.1")
        except OSError as error:
            raise DeviceError(f"CUDA's driver can't be opened: {error}") from None
        self.call("cuInit", 0)
        count = _ffi.new("int *")
        self.call("cuDeviceGetCount", count)
        self.ordinal = next((i for i in range(count[0]) if self._uuid(i) == device_uuid), -1)
        """The device's number in CUDA."""
        if self.ordinal < 0:
            raise DeviceError(f"CUDA shows no device with the UUID {device_uuid}: see CUDA_VISIBLE_DEVICES")
        context = _ffi.new("CUcontext *")
        self.call("cuDevicePrimaryCtxRetain", context, self._handle(self.ordinal))
        self._context = context[0]

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver. Raises DeviceError with its name and CUDA's reason."""
        if result := getattr(self._lib, name)(*arguments):
            text = _ffi.new("const char **")
            self._lib.cuGetErrorString(result, text)
            reason = _ffi.string(text[0]).decode() if text[0] != _ffi.NULL else f"error {result}"
            raise DeviceError(f"{name}: {reason}")

    @contextmanager
    def current(self) -> Iterator[None]:
        """Have the context current in this thread."""
        self.call("cuCtxPushCurrent_v2", self._context)
        try:
            yield
        finally:
            self.call("cuCtxPopCurrent_v2", _ffi.new("CUcontext *"))

    def close(self) -> None:
        """Give the context back."""
        self.call("cuDevicePrimaryCtxRelease_v2", self._handle(self.ordinal))

    def import_timeline(self, fd: int) -> CData:
        """A timeline semaphore, whose file descriptor then belongs to CUDA."""
        semaphore = _ffi.new("CUexternalSemaphore *")
        with self.current():
            self.call("cuImportExternalSemaphore", semaphore, _ffi.new(
                "CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC *", {"type": _TIMELINE_FD, "handle": {"fd": fd}}
            ))  # fmt: skip
        return semaphore[0]

    def destroy_semaphore(self, semaphore: CData) -> None:
        with self.current():
            self.call("cuDestroyExternalSemaphore", semaphore)

    def wait(self, semaphore: CData, value: int, stream: int) -> None:
        """Have the work that a stream gets from now on wait until a timeline semaphore has a value."""
        wait = _ffi.new("CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS *", {"params": {"value": value}})
        with self.current():
            self.call("cuWaitExternalSemaphoresAsync", _ffi.new("CUexternalSemaphore *", semaphore), wait, 1,
                      _ffi.cast("CUstream", stream))  # fmt: skip

    def _handle(self, ordinal: int) -> int:
        handle = _ffi.new("CUdevice *")
        self.call("cuDeviceGet", handle, ordinal)
        return int(handle[0])

    def _uuid(self, ordinal: int) -> str:
        found = _ffi.new("CUuuid *")
        self.call("cuDeviceGetUuid_v2", found, self._handle(ordinal))
        return str(uuid.UUID(bytes=bytes(_ffi.buffer(found))))


class CudaMemory:
    """Memory of `size` bytes that CUDA imports from a file descriptor, which then belongs to CUDA. `address` is its
    pointer. `allocated`: the bytes of the dedicated allocation of Vulkan."""

    def __init__(self, cuda: Cuda, fd: int, allocated: int, size: int) -> None:
        self._cuda = cuda
        memory, pointer = _ffi.new("CUexternalMemory *"), _ffi.new("CUdeviceptr *")
        with cuda.current():
            cuda.call("cuImportExternalMemory", memory, _ffi.new("CUDA_EXTERNAL_MEMORY_HANDLE_DESC *", {
                "type": _OPAQUE_FD, "handle": {"fd": fd}, "size": allocated, "flags": _DEDICATED,
            }))  # fmt: skip
            self._memory = memory[0]
            cuda.call("cuExternalMemoryGetMappedBuffer", pointer, self._memory,
                      _ffi.new("CUDA_EXTERNAL_MEMORY_BUFFER_DESC *", {"size": size}))  # fmt: skip
        self.address = int(pointer[0])

    def close(self) -> None:
        with self._cuda.current():
            self._cuda.call("cuMemFree_v2", self.address)
            self._cuda.call("cuDestroyExternalMemory", self._memory)


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
        with self._cuda.current():
            self._cuda.call("cuEventDestroy_v2", self._event)
