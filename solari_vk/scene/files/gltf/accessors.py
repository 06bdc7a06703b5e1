"""Accessors: typed arrays from a glTF file's buffers, for all component types, packings and sparse accessors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.values import Entry

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {
    "SCALAR": (1, 1),
    "VEC2": (1, 2),
    "VEC3": (1, 3),
    "VEC4": (1, 4),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
LARGEST_WITHOUT_DATA = 2**24
_ROUNDING = 0.1  # of integers that Draco has quantized


class _Layout(NamedTuple):
    """How an element lies in memory: in columns of numbers, of which scalars and vectors have one."""

    dtype: np.dtype[Any]
    columns: int = 1
    rows: int = 1

    @property
    def width(self) -> int:
        """Components of an element."""
        return self.columns * self.rows

    @property
    def column_size(self) -> int:
        """Bytes from one column to the next. Every column of a matrix starts at a multiple of four bytes."""
        size = self.rows * self.dtype.itemsize
        return size if self.columns == 1 else -(-size // 4) * 4


class Accessors:
    """Decodes accessors, and keeps the results."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._floats: dict[int, NDArray[np.float32]] = {}
        self._provided: dict[int, NDArray[Any]] = {}

    def provide(self, index: int, array: NDArray[Any], user: Entry) -> None:
        """Replace the data of an accessor by an array (count, components). Integers get the accessor's own type, also
        those that come as floats, as some encoders store joints."""
        entry = self._document.item("accessor", index, user)
        component = _component(entry)
        width = _Layout(component, *_shape(entry)).width
        if array.ndim != 2 or array.shape[1] != width:
            raise entry.error(f"has {width} components, but the data of {user.place} has the shape {array.shape}")
        if array.dtype.kind != "f" or (component.kind != "f" and not entry.flag("normalized", False)):
            # A cast that loses a value is found by casting back.
            with np.errstate(invalid="ignore"):
                converted = np.rint(array).astype(component)
            if not (np.abs(array - converted.astype(np.float64)) <= _ROUNDING).all():
                raise entry.error(f"has {component.name} values, which are too narrow for those of {user.place}")
            array = converted
        self._floats.pop(index, None)
        self._provided[index] = array

    def find_data(self, index: int, user: Entry) -> None:
        """Raise SolariError if an accessor's bytes aren't there."""
        accessor = self._document.item("accessor", index, user)
        view = accessor.index("bufferView")
        if view is not None:
            self._document.view(view, accessor)

    def floats(self, index: int, user: Entry, kinds: tuple[str, ...]) -> NDArray[np.float32]:
        """Finite float32 values (count, components); integers are normalized if the accessor is.

        Matrices have one row of components, in the file's column order.
        """
        array = self._floats.get(index)
        entry = self._document.item("accessor", index, user)
        self._check_kind(entry, user, kinds)
        if array is None:
            raw = self._decode(index, entry)
            entry.charge(4 * raw.size, "its data", working=4 * raw.size)
            # glTF 2.0, 3.6.2.2: c / 127 of signed bytes, and so on.
            if entry.flag("normalized", False) and raw.dtype.kind in "iu":
                # The most negative integer has no positive partner: the format clamps it to -1.
                array = np.maximum(raw / np.float32(np.iinfo(raw.dtype).max), np.float32(-1)).astype(np.float32)
            else:
                array = raw.astype(np.float32, copy=False)
            finite = np.isfinite(array)
            if not finite.all():
                # The first element with a NaN or infinity, for the message.
                row = int(np.argmin(finite.all(axis=1)))
                raise entry.error(
                    f"(used by {user.place}) has {array[row].tolist()} at element {row}: all values must be finite; "
                    "export the file again"
                )
            self._floats[index] = array
        return array

    def integers(self, index: int, user: Entry, kinds: tuple[str, ...]) -> NDArray[Any]:
        """Unsigned integers (count, components); such values may be stored in a type that has others too."""
        entry = self._document.item("accessor", index, user)
        self._check_kind(entry, user, kinds)
        array = self._decode(index, entry)
        if array.dtype.kind == "u":
            return array
        entry.charge(4 * array.size, "its data")
        with np.errstate(invalid="ignore"):
            integers = array.astype(np.uint32)
        if (integers != array).any():
            raise entry.error(f"(used by {user.place}) must hold unsigned integers, not {array.dtype.name}")
        return integers

    def count(self, index: int, user: Entry) -> int:
        """The number of elements, without decoding them."""
        if index in self._provided:
            return len(self._provided[index])
        return self._document.item("accessor", index, user).integer("count")

    def has_data(self, index: int, user: Entry) -> bool:
        """Whether the accessor has data of its own."""
        entry = self._document.item("accessor", index, user)
        return "bufferView" in entry or "sparse" in entry

    @staticmethod
    def _check_kind(entry: Entry, user: Entry, kinds: tuple[str, ...]) -> None:
        kind = entry.text("type", None, tuple(_SHAPES))
        if kind not in kinds:
            raise entry.error(f"(used by {user.place}) has the type {kind}, but must be {' or '.join(kinds)}")

    def _decode(self, index: int, entry: Entry) -> NDArray[Any]:
        if index in self._provided:
            return self._provided[index]
        count = entry.integer("count")
        layout = _Layout(_component(entry), *_shape(entry))
        width = layout.width
        if count == 0:
            return np.zeros((0, width), layout.dtype)
        if "bufferView" in entry:
            array = self._read(entry, count, layout)
            self._document.charge(array.nbytes, entry)
        else:
            # glTF 2.0, 3.6.2.3: without a view all is zero, which a sparse accessor then changes.
            if count > LARGEST_WITHOUT_DATA:
                raise entry.error(f"has {count} elements but no data; at most {LARGEST_WITHOUT_DATA} are allowed")
            self._document.charge(count * width * layout.dtype.itemsize, entry)
            array = np.zeros((count, width), layout.dtype)
        sparse = entry.entry("sparse")
        return array if sparse is None else self._replace(sparse, array, layout)

    def _replace(self, sparse: Entry, array: NDArray[Any], layout: _Layout) -> NDArray[Any]:
        """The array with the rows that a sparse accessor replaces."""
        count = sparse.integer("count", high=len(array))
        where, what = sparse.entry("indices"), sparse.entry("values")
        if where is None or what is None:
            raise sparse.error("needs 'indices' and 'values'; export the file again")
        if count == 0:
            return array
        kind = _component(where)
        if kind.kind != "u":
            raise where.wrong("componentType", "an unsigned integer type")
        indices = self._read(where, count, _Layout(kind))[:, 0]
        # Indices should ascend strictly, but nothing here depends on it.
        if int(indices.max()) >= len(array):
            raise where.error(f"refers to element {indices.max()}, but there are {len(array)}; export the file again")
        replaced = array.copy()
        replaced[indices] = self._read(what, count, layout)
        return replaced

    def _read(self, entry: Entry, count: int, layout: _Layout) -> NDArray[Any]:
        """Elements (count, columns * rows) as a view of the bytes if possible; they need not be aligned."""
        data, stride = self._document.view(entry.integer("bufferView"), entry)
        offset = entry.integer("byteOffset", 0)
        dtype, columns, rows = layout
        size = layout.column_size * (columns - 1) + rows * dtype.itemsize
        # Without a stride elements are packed; the last needs no gap after it.
        step = stride or layout.column_size * columns
        if step < size:
            raise entry.error(f"has elements of {size} bytes in a view with a stride of {step}; export the file again")
        needed = offset + (count - 1) * step + size
        if needed > len(data):
            raise entry.error(
                f"needs {needed} bytes for its {count} elements but its buffer view has {len(data)}; "
                "the file is truncated or damaged: export it again"
            )
        strides = (step, layout.column_size, dtype.itemsize)
        elements: NDArray[Any] = np.ndarray((count, columns, rows), dtype, data, offset, strides)
        return elements.reshape(count, layout.width)


def _shape(entry: Entry) -> tuple[int, int]:
    """Columns and rows of an element."""
    return _SHAPES[entry.text("type", None, tuple(_SHAPES))]


def _component(entry: Entry) -> np.dtype[Any]:
    code = entry.integer("componentType")
    if code not in _COMPONENTS:
        raise entry.wrong("componentType", "5120 to 5123, 5125 or 5126")
    return np.dtype(_COMPONENTS[code])
