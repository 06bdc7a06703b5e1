"""Packs plain numbers into fields of a record by `struct`.

For the few numbers that change with each frame this takes a quarter of numpy's time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError

_CODES = {"f4": "f", "f8": "d", "u4": "I", "i4": "i", "u8": "Q", "i8": "q"}


def packing(dtype: np.dtype[Any], names: Sequence[str]) -> tuple[struct.Struct, int]:
    """A `struct` that packs these fields of a record, and the byte offset of the first.

    A field of several numbers takes them one by one. Raises SolariError unless the record has these fields, in this
    order and without gaps.
    """
    fields: Any = dtype.fields or {}
    missing = [name for name in names if name not in fields]
    if missing:
        raise SolariError(f"the shaders' record has no field {missing[0]}; there are {', '.join(fields) or 'none'}")
    begin = end = fields[names[0]][1]
    format = "="
    for name in names:
        kind, offset = fields[name][:2]
        if offset != end:
            raise SolariError(f"field {name} of the record must follow the one before it without a gap: {names}")
        format += _format(kind, name)
        end = offset + kind.itemsize
    return struct.Struct(format), begin


def _format(kind: np.dtype[Any], name: str) -> str:
    if kind.fields:
        packed, begin = packing(kind, tuple(kind.fields))
        if begin or packed.size != kind.itemsize:
            raise SolariError(f"field {name} of the record has a gap")
        return packed.format[1:]
    base, shape = kind.subdtype or (kind, ())
    return f"{int(np.prod(shape))}{_CODES[base.str[1:]]}"
