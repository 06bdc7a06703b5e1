"""The uniform blocks of a frame on the host, in one array of bytes, with fields that are set by name."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, unknown_name

# The letters of `struct` for numpy's types.
_CODES = {"f4": "f", "f8": "d", "u4": "I", "i4": "i", "u8": "Q", "i8": "q"}


class Writer:
    """A fast way to set fields of a uniform block: `writer.write(*numbers)`.

    A field of several numbers takes them one by one. The call does nothing while no shader has the block, and raises
    SolariError if the block has no such fields next to each other.
    """

    def __init__(self, block: str, names: Sequence[str]) -> None:
        self.block = block
        self.names = tuple(names)
        self.write: Callable[..., None] = _ignore


def _ignore(*_: float) -> None:
    pass


def _refuse(why: str, *_: float) -> None:
    raise SolariError(why)


class Uniforms:
    """All uniform blocks that a frame's shaders declare: `uniforms["camera.near"] = 0.1`, spelled as in the shaders.

    Matrices are stored by columns: assign a numpy matrix transposed. A value stays until it is changed, and a frame
    takes the values that the blocks have when it is submitted. Raises SolariError for an unknown name or a wrong shape.
    """

    def __init__(self, alignment: int) -> None:
        self.memory = np.zeros(0, np.uint8)
        """The bytes that each frame copies to the device."""
        self.offsets: dict[str, int] = {}
        """The byte at which each block begins, a multiple of the device's alignment."""
        self.version = 0
        """Incremented whenever other blocks are declared."""
        self._alignment = alignment
        self._types: dict[str, np.dtype[Any]] = {}
        self._fields: dict[str, np.ndarray] = {}
        self._writers: list[Writer] = []

    def declare(self, blocks: Mapping[str, np.dtype[Any]]) -> None:
        """Replace the blocks. A field that existed before with the same type keeps its value."""
        if blocks == self._types:
            return
        # Blocks are ranges of one buffer: each must begin at the device's alignment for uniform buffers.
        offsets: dict[str, int] = {}
        end = 0
        for name, dtype in blocks.items():
            offsets[name] = -(-end // self._alignment) * self._alignment
            end = offsets[name] + dtype.itemsize
        before = self._fields
        self.memory = np.zeros(end, np.uint8)
        self.offsets = offsets
        self._types = dict(blocks)
        self._fields = {}
        for name in blocks:
            record = self.record(name)
            for field in record.dtype.names or ():
                self._fields[f"{name}.{field}"] = record[field]
        for name, values in self._fields.items():
            if name in before and before[name].dtype == values.dtype and before[name].shape == values.shape:
                values[:] = before[name]
        # The memory is another one now, and writers hold a view of the old one.
        for writer in self._writers:
            self._renew(writer)
        self.version += 1

    def record(self, block: str) -> np.ndarray:
        """A block as an array of one record; a view of `memory`, valid until other blocks are declared."""
        if block not in self._types:
            raise unknown_name("the shaders have no uniform block", block, self._types)
        first = self.offsets[block]
        return self.memory[first : first + self._types[block].itemsize].view(self._types[block])

    def writer(self, block: str, names: Sequence[str]) -> Writer:
        """What sets fields of a block, which must follow each other, to plain numbers. It stays valid when other
        blocks are declared."""
        writer = Writer(block, names)
        self._writers.append(writer)
        self._renew(writer)
        return writer

    def _renew(self, writer: Writer) -> None:
        writer.write = _ignore
        if writer.block not in self._types:
            return
        try:
            packed, offset = packing(self._types[writer.block], writer.names)
        except SolariError as error:
            writer.write = partial(_refuse, str(error))
        else:
            writer.write = partial(packed.pack_into, self.memory.data, self.offsets[writer.block] + offset)

    def __getitem__(self, name: str) -> Any:
        return self._field(name)[0]

    def __setitem__(self, name: str, value: Any) -> None:
        target = self._field(name)
        shape = value.shape if isinstance(value, np.ndarray) else np.shape(value)
        # numpy would repeat a smaller array silently; only plain numbers may fill a field.
        if shape != target.shape[1:] and shape:
            raise SolariError(f"the uniform {name} has shape {target.shape[1:]}, not {shape}")
        try:
            target[0] = value
        except (TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"the uniform {name} is {target.dtype}: {error}") from error

    def update(self, values: Mapping[str, Any]) -> None:
        """Set fields by name. Raises SolariError for a name that no shader has, before any field is set."""
        for name in values:
            self._field(name)
        self.update_declared(values)

    def update_declared(self, values: Mapping[str, Any]) -> None:
        """As `update`, but names that no shader has are ignored: shaders declare only what they use."""
        for name, value in values.items():
            if name in self._fields:
                self[name] = value

    def __contains__(self, name: str) -> bool:
        """Whether there is a block or a field ("block.field") of this name."""
        return name in self._types or name in self._fields

    def _field(self, name: str) -> np.ndarray:
        try:
            return self._fields[name]
        except KeyError:
            raise unknown_name("the shaders have no uniform", name, self._fields) from None


def packing(dtype: np.dtype[Any], names: Sequence[str]) -> tuple[struct.Struct, int]:
    """A `struct` that packs these fields of a record, and the byte offset of the first.

    For the few numbers that change with each frame this takes a quarter of numpy's time. A field of several numbers
    takes them one by one. Raises SolariError unless the record has these fields, in this
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
