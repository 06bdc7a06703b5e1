"""Fields of a record as `struct` packs them, from plain numbers.

For the few numbers of a frame that is a quarter of what numpy takes: after a frame nothing of Python is in the
processor's caches any more, and numpy's way into a structured array is long.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError

_CODES = {"f4": "f", "f8": "d", "u4": "I", "i4": "i", "u8": "Q", "i8": "q"}


def packing(dtype: np.dtype[Any], names: Sequence[str]) -> tuple[struct.Struct, int]:
    """What packs these fields of a record, and the byte at which they begin.

    Fields of several numbers take them one by one. Raises SolariError unless there are such fields, one right behind
    the other in this order.
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
            raise SolariError(f"field {name} of the shaders' record must come right behind the one before: {names}")
        base, shape = kind.subdtype or (kind, ())
        format += f"{int(np.prod(shape))}{_CODES[base.str[1:]]}"
        end = offset + kind.itemsize
    return struct.Struct(format), begin


def writer(record: NDArray[Any], names: Sequence[str]) -> Callable[..., None]:
    """A function that sets these fields of a record array's first record, as `packing` has them, to its arguments."""
    packed, begin = packing(record.dtype, names)
    return partial(packed.pack_into, record.view(np.uint8).data, begin)
