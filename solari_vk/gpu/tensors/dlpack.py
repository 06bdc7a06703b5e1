"""DLPack: memory that other libraries take as tensors without a copy (dmlc/dlpack, version 0.8)."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np

# DLDeviceType and DLDataTypeCode of dlpack.h.
CPU = 1
CUDA = 2
ROCM = 10
_KINDS = {"i": 0, "u": 1, "f": 2}


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device_type", ctypes.c_int32),
        ("device_id", ctypes.c_int32),
        ("ndim", ctypes.c_int32),
        ("kind", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
        ("manager", ctypes.c_void_p),
        ("deleter", ctypes.c_void_p),
    )


# What tensors need, by the addresses of their structures: DLPack's consumers hold an address alone, and nothing of
# Python keeps the structure and the owner of the memory alive.
_references: dict[int, tuple[Any, ...]] = {}


def _of_python(name: str, result: Any, *arguments: Any) -> Any:
    """A function of Python's. Attributes of ctypes.pythonapi are shared, and Warp gives them other types."""
    return ctypes.PYFUNCTYPE(result, *arguments)((name, ctypes.pythonapi))


_new = _of_python("PyCapsule_New", ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
_is_valid = _of_python("PyCapsule_IsValid", ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)
_pointer = _of_python("PyCapsule_GetPointer", ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)


def _delete(address: int) -> None:
    """A consumer doesn't need a tensor any more."""
    *_, released = _references.pop(address)
    released()


def _delete_unused(capsule: int) -> None:
    """A capsule is gone. Consumers rename those that they have taken, and call the deleter themselves."""
    if _is_valid(capsule, b"dltensor"):
        _delete(_pointer(capsule, b"dltensor"))


_delete_in_c = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_delete)
_delete_unused_in_c = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(_delete_unused)


def described(capsule: Any) -> tuple[int, tuple[int, ...], np.dtype[Any] | None]:
    """The address, shape and dtype of the memory that a capsule "dltensor" shows; no dtype for numbers that aren't
    packed, or of a kind that numpy lacks. The capsule keeps the memory."""
    # The capsule holds a DLManagedTensor, which begins with the DLTensor.
    tensor = _Tensor.from_address(_pointer(id(capsule), b"dltensor"))
    shape = tuple(tensor.shape[: tensor.ndim])
    # Strides are counted in elements here. NULL means packed in row-major order.
    packed = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    steps = tensor.strides[: tensor.ndim] if tensor.strides else packed
    kind = next((name for name, number in _KINDS.items() if number == tensor.kind), None)
    # A dimension of size 1 may have any stride.
    ordered = all(step == wanted or size < 2 for step, wanted, size in zip(steps, packed, shape, strict=True))
    plain = kind is not None and tensor.lanes == 1 and ordered
    dtype = np.dtype(f"{kind}{tensor.bits // 8}") if plain else None
    return (tensor.data or 0) + tensor.byte_offset, shape, dtype


def capsule(
    address: int, shape: tuple[int, ...], dtype: np.dtype[Any], device: tuple[int, int], released: Callable[[], None]
) -> Any:
    """A capsule "dltensor" for packed memory. released: called, by any thread, when nobody needs the memory."""
    # The structure points to the shape, so both live until the consumer is done.
    sizes = (ctypes.c_int64 * len(shape))(*shape)
    tensor = _Tensor(
        address,
        *device,
        len(shape),
        _KINDS[dtype.kind],
        8 * dtype.itemsize,
        1,
        sizes,
        None,
        0,
        None,
        ctypes.cast(_delete_in_c, ctypes.c_void_p),
    )
    at = ctypes.addressof(tensor)
    _references[at] = tensor, sizes, released
    return _new(at, b"dltensor", ctypes.cast(_delete_unused_in_c, ctypes.c_void_p))
