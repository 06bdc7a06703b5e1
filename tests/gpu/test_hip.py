"""Tensors by HIP, and errors of CUDA's set-up, with libraries that stand in for AMD's and NVIDIA's."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import gc
import mmap
import os

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.gpu.tensors import cuda, dlpack, exports, shared_memory

FILE_BEGIN = 4096  # where lavapipe's memory begins in the file that it exports
ADDRESS = "0000:03:00.0"
POINTER = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


class Library:
    """What libamdhip64 is to cffi, as far as it is declared: maps the exported memory, and records calls."""

    def __init__(self, failing=""):
        self.calls = []
        self._failing = failing
        self._maps = []

    known = {*cuda._HIP.values(), "hipDeviceGetByPCIBusId"}

    def __getattr__(self, name):
        if name not in self.known:
            raise AttributeError(name)

        def called(*arguments):
            self.calls.append((name, *arguments))
            if name == self._failing:
                return 1
            own = getattr(self, f"_{name}", None)
            return 0 if own is None else own(*arguments)

        return called

    def _hipDrvGetErrorString(self, result, text):
        self._text = cuda._ffi.new("char[]", b"out of order")
        text[0] = self._text
        return 0

    def _hipDeviceGetByPCIBusId(self, ordinal, address):
        ordinal[0] = 3 if address == ADDRESS.encode() else -1
        return 0 if address == ADDRESS.encode() else 101

    def _hipImportExternalMemory(self, memory, described):
        assert (described.type, described.flags) == (1, 1)
        fd = described.handle.fd
        mapped = mmap.mmap(fd, os.fstat(fd).st_size)
        assert described.size <= len(mapped)
        os.close(fd)  # which now belongs to HIP
        self._maps.append(mapped)
        memory[0] = cuda._ffi.cast("void *", len(self._maps))
        return 0

    def _hipExternalMemoryGetMappedBuffer(self, pointer, memory, described):
        mapped = self._maps[int(cuda._ffi.cast("intptr_t", memory)) - 1]
        assert (described.offset, described.flags) == (0, 0)
        pointer[0] = ctypes.addressof(ctypes.c_char.from_buffer(mapped)) + FILE_BEGIN
        return 0

    def _hipMemcpyDtoDAsync(self, target, source, size, stream):
        ctypes.memmove(target, source, size)
        return 0

    @property
    def names(self):
        return [name for name, *_ in self.calls if not name.startswith("hipCtxP")]


@pytest.fixture
def amd(device, monkeypatch):
    """The device as one of AMD's, and its library."""
    if device.properties.kind != "cpu" or shared_memory.MEMORY not in device.extensions:
        pytest.skip("needs a software device that exports memory")
    library = Library()
    monkeypatch.setattr(cuda._ffi, "dlopen", lambda name: library, raising=False)
    monkeypatch.setattr(shared_memory, "pci_address", lambda device: ADDRESS)
    changed = dataclasses.replace(device.properties, vendor_id=exports.AMD, kind="discrete gpu")
    monkeypatch.setattr(device, "properties", changed)
    return library


def test_structures_have_the_sizes_of_hip():
    """Those of hip_runtime_api.h on x86-64, which are CUDA's."""
    sizes = {
        "CUDA_EXTERNAL_MEMORY_HANDLE_DESC": 104,
        "CUDA_EXTERNAL_MEMORY_BUFFER_DESC": 88,
        "CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC": 96,
        "CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS": 144,
        "CUDA_EXTERNAL_SEMAPHORE_SIGNAL_PARAMS": 144,
    }
    assert {name: cuda._ffi.sizeof(name) for name in sizes} == sizes


def test_tensors_by_hip(device, amd):
    tensors = exports.TensorExports(device, device.memory)
    with sv.PathTracer(device, sv.builtin("cornell_box"), (24, 16)) as tracer:
        expected = tracer.render(samples=1)["radiance"]
        buffer = tracer._frame.resource("radiance_mean")
        copy = lambda cmd, target: buffer.record_copy(cmd, target, size=expected.nbytes)  # noqa: E731
        tensor = tensors.export(copy, expected.shape, expected.dtype)
        assert repr(tensor) == "<CudaTensor (16, 24, 3) float32 on HIP device 3>"
        assert tensor.__dlpack_device__() == (dlpack.ROCM, 3) == (10, 3)
        capsule = tensor.__dlpack__(stream=5)
        address = ctypes.c_void_p.from_address(POINTER(capsule, b"dltensor")).value
        seen = np.ctypeslib.as_array((ctypes.c_float * expected.size).from_address(address))
        assert np.array_equal(seen.reshape(expected.shape), expected)
        assert "hipEventRecord" not in amd.names
        del capsule
        assert amd.names[-2:] == ["hipEventCreateWithFlags", "hipEventRecord"]
        assert int(cuda._ffi.cast("intptr_t", amd.calls[-2][-1])) == 5
        anywhere = tensor.__dlpack__(stream=-1)
        del anywhere, tensor, seen
        gc.collect()
        device.wait_idle()
        tensors.export(copy, expected.shape, expected.dtype)  # in the same memory
    assert amd.names.count("hipImportExternalMemory") == 1
    assert amd.names[-3:] == ["hipCtxSynchronize", "hipEventSynchronize", "hipEventDestroy"]
    gc.collect()
    device.wait_idle()
    tensors._end()
    assert amd.names[-4:] == ["hipFree", "hipDestroyExternalMemory", "hipDeviceGet", "hipDevicePrimaryCtxRelease"]


@pytest.mark.parametrize(
    ("failing", "said"),
    [
        ("hipDeviceGetByPCIBusId", f"HIP shows no device at the PCI address {ADDRESS}: .*out of order"),
        ("hipDevicePrimaryCtxRetain", "hipDevicePrimaryCtxRetain: out of order"),
    ],
)
def test_what_hip_lacks_is_said(device, amd, failing, said):
    amd._failing = failing
    with pytest.raises(sv.DeviceError, match=said):
        exports.TensorExports(device, device.memory)


def open_inodes():
    """Devices and inodes of the process' open files; each exported memory has its own."""
    found = set()
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(FileNotFoundError):  # the listed folder itself
            status = os.stat(f"/proc/self/fd/{name}")
            found.add((status.st_dev, status.st_ino))
    return found


@pytest.mark.parametrize("failing", ["hipImportExternalMemory", "hipExternalMemoryGetMappedBuffer"])
def test_an_error_halfway_frees_all(device, amd, failing):
    tensors = exports.TensorExports(device, device.memory)
    amd._failing = failing
    before = open_inodes()
    with pytest.raises(sv.DeviceError, match=f"{failing}: out of order"):
        tensors.export(None, (4,), np.dtype(np.float32))
    amd._maps.clear()
    assert open_inodes() <= before  # files of earlier tests may be closed meanwhile
    assert ("hipDestroyExternalMemory" in amd.names) == (failing == "hipExternalMemoryGetMappedBuffer")
    tensors._end()


def test_a_device_without_a_bus_says_so(device):
    if "VK_EXT_pci_bus_info" in device.offered_extensions:
        assert len(shared_memory.pci_address(device)) == len(ADDRESS)
    else:
        with pytest.raises(sv.DeviceError, match="lacks VK_EXT_pci_bus_info"):
            shared_memory.pci_address(device)
