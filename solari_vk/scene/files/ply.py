"""PLY files as arrays: Turk, "The PLY polygon file format" (1994). Lines end with LF, CR LF or CR, as they do there."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError

_MOST_ELEMENTS, _MOST_PROPERTIES = 16, 256
_BYTES_PER_VALUE, _BYTES_PER_ROW = 8, 250  # of text; of elements whose lists differ in length
# What follows a header that ends with CR is data, also if it is LF.
_HEADER = re.compile(rb"\Aply[ \t]*(\r\n|\n|\r)(.{0,100000}?[\r\n])end_header[ \t]*(?:\1|\r\n|\n)", re.DOTALL)
_PADDING = b" \t\r\n\0\x1a"  # behind a text; 1A ends files in CP/M and DOS
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip


class Lists(NamedTuple):
    """The lists of a property, one after the other, and how many values each has (N,)."""

    values: NDArray[Any]
    counts: NDArray[np.int64]


@dataclass
class Element:
    """A kind of element, such as "vertex": its number, and its values by property."""

    count: int
    types: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Of each property: the type of a list's length, "" for a single number, and of its values."""
    values: dict[str, NDArray[Any] | Lists] = field(default_factory=dict)


class _Source:
    """The numbers after the header. end: "<" or ">" for binary ones, "" for text."""

    def __init__(self, body: bytes, end: str, who: str) -> None:
        self.at = 0
        self.end = end
        self._who = who
        self._data: Any = body
        if not end:
            charge(0, who, "its text", working=_BYTES_PER_VALUE * len(body) // 2)
            body = body.rstrip(_PADDING)
            try:
                with warnings.catch_warnings(
                    action="error"
                ):  # versions of numpy warn of what is no number, or refuse it
                    self._data = np.fromstring(body, np.float64, sep=" ")
            except (ValueError, DeprecationWarning):
                raise SolariError(f"{who}: has text where numbers should be: export it again") from None

    def take(self, kind: str, count: int) -> NDArray[Any]:
        """The next numbers of a type."""
        size = np.dtype(kind).itemsize if self.end else 1
        if count * size > len(self._data) - self.at:
            raise SolariError(f"{self._who}: is cut off, or says that it has more than it has: export it again")
        start, self.at = self.at, self.at + count * size
        return np.frombuffer(self._data, self.end + kind, count, start) if self.end else self._data[start : self.at]

    def property(self, length: str, kind: str) -> NDArray[Any]:
        """The next values of a property; length: the type of a list's length, "" for a single number."""
        count = float(self.take(length, 1)[0]) if length else 1.0
        if not 0 <= count < 2**31 or not count.is_integer():
            raise SolariError(f"{self._who}: has a list of {count:g} values: export it again")
        return self.take(kind, int(count))

    def typed(self, values: NDArray[Any], kind: str) -> NDArray[Any]:
        """Numbers that were taken, as the type that the header declares. Those that may have fractions keep all of the
        digits of a text."""
        if self.end or np.dtype(kind).kind == "f":
            return values
        with np.errstate(invalid="ignore"):  # of what the type can't hold
            found = values.astype(kind)
        wrong = values[found != values]
        if len(wrong):
            raise SolariError(
                f"{self._who}: has {wrong[0]:g} where its header declares {np.dtype(kind).name}: export it again"
            )
        return found

    def block(self, count: int, columns: list[tuple[str, int]]) -> list[NDArray[Any]]:
        """The next rows of columns, each of a type and a width: an array (count, width) for each column."""
        if not self.end:
            width = sum(width for _, width in columns)
            rows = self.take("", count * width).reshape(count, width)
            return np.split(rows, np.cumsum([width for _, width in columns])[:-1], axis=1)
        layout = np.dtype([(str(number), self.end + kind, (width,)) for number, (kind, width) in enumerate(columns)])
        found = self.take("u1", count * layout.itemsize).view(layout)
        return [found[str(number)] for number in range(len(columns))]


def read_ply(data: bytes, who: str) -> tuple[dict[str, Element], list[str]]:
    """The elements of a file by name, and the files of textures that its comments name.

    who: the file, for errors. Raises SolariError for damage, and for a file that says that it has more than it has.
    """
    header = _HEADER.match(data)
    if header is None:
        raise SolariError(f"{who}: its header is missing or too long: export it again")
    elements, textures, end = _header(header[2].decode("utf-8", "replace"), who)
    count = sum(len(element.types) for element in elements.values())
    if len(elements) > _MOST_ELEMENTS or count > _MOST_PROPERTIES:
        raise SolariError(
            f"{who}: has {len(elements)} elements and {count} properties; at most {_MOST_ELEMENTS} and "
            f"{_MOST_PROPERTIES} are read: leave out what isn't needed"
        )
    source = _Source(data[header.end() :], end, who)
    for element in elements.values():
        if element.count and element.types:
            _read(element, source, who)
    return elements, textures


def _header(text: str, who: str) -> tuple[dict[str, Element], list[str], str]:
    """The elements that a header declares, the textures that it names, and the end of the numbers: see `_Source`."""
    elements: dict[str, Element] = {}
    latest = Element(0)
    textures = []
    end = None
    for line in re.split(r"[\r\n]+", text):
        words = line.split()
        taken: Any = elements if words[:1] == ["element"] else latest.types
        match words:
            case ["format", kind, *_]:
                end = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}.get(kind)
            case ["comment", word, _, *_] if word.lower() == "texturefile":
                textures.append(line.split(None, 2)[2].strip())
            case ["element", name, *_] | ["property", *_, name] if name in taken:
                raise SolariError(f"{who}: its header has a name twice, '{line[:80]}': export it again")
            case ["element", name, number] if number.isdecimal() and len(number) < 19:
                latest = elements[name] = Element(int(number))
            case ["property", "list", length, kind, name] if elements and length in _TYPES and kind in _TYPES:
                latest.types[name] = _TYPES[length], _TYPES[kind]
            case ["property", kind, name] if elements and kind in _TYPES:
                latest.types[name] = "", _TYPES[kind]
            case ["element" | "property", *_]:
                raise SolariError(f"{who}: its header has a wrong line, '{line[:80]}': export it again")
    if end is None:
        raise SolariError(f"{who}: its header has no format that is read: export it as ascii or binary PLY 1.0")
    return elements, textures, end


def _read(element: Element, source: _Source, who: str) -> None:
    """Read the values of a kind of element: at once if each list of a property has the length of the first one."""
    start = source.at
    widths = [len(source.property(*types)) for types in element.types.values()]
    source.at = start
    columns: list[tuple[str, int]] = []
    for (length, kind), width in zip(element.types.values(), widths, strict=True):
        columns += [(length, 1), (kind, width)] if length else [(kind, width)]
    try:
        blocks = source.block(element.count, columns)
    except SolariError:
        # Later lists may be shorter, so that there is enough all the same.
        if not any(length for length, _ in element.types.values()):
            raise
        blocks = []
    element.values = _columns(element, widths, blocks)
    if not element.values:
        source.at = start
        element.values = _rows(element, source, who)
    for name, values in element.values.items():
        kind = element.types[name][1]
        if isinstance(values, Lists):
            element.values[name] = values._replace(values=source.typed(values.values, kind))
        else:
            element.values[name] = source.typed(values, kind)


def _columns(element: Element, widths: list[int], blocks: list[NDArray[Any]]) -> dict[str, NDArray[Any] | Lists]:
    """The values of an element that was read at once; nothing if a list has another length than the first one."""
    found: dict[str, NDArray[Any] | Lists] = {}
    remaining = iter(blocks)
    for (name, (length, _)), width in zip(element.types.items(), widths, strict=True):
        if not blocks or (length and (next(remaining) != width).any()):
            return {}
        values = next(remaining).reshape(-1)
        found[name] = Lists(values, np.full(element.count, width)) if length else values
    return found


def _rows(element: Element, source: _Source, who: str) -> dict[str, NDArray[Any] | Lists]:
    """The values of elements whose lists differ in length, which are read one by one."""
    charge(0, who, f"{element.count:,} elements", working=_BYTES_PER_ROW * element.count * len(element.types))
    rows: dict[str, list[NDArray[Any]]] = {name: [] for name in element.types}
    for _ in range(element.count):
        for name, types in element.types.items():
            rows[name].append(source.property(*types))
    values = {name: np.concatenate(parts) for name, parts in rows.items()}
    return {
        name: Lists(found, np.array([len(part) for part in rows[name]])) if element.types[name][0] else found
        for name, found in values.items()
    }
