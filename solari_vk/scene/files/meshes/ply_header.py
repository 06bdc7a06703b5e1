"""What a .ply file says of its data: the reader of trimesh believes it, and takes memory and time for it."""

from __future__ import annotations

import re

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError

_MOST_ELEMENTS, _MOST_PROPERTIES = 16, 256
_HEADER = re.compile(rb"\Aply.{,100000}?^end_header\r?\n", re.DOTALL | re.MULTILINE)
_LINE = re.compile(rb"(?m)^(?:element[ \t]+\S+[ \t]+(\d{1,18})|property[ \t])")
_BYTES_PER_LINE, _BYTES_PER_VALUE = 250, 250  # of text, as arrays of numpy


def check_ply(data: bytes, who: str) -> None:
    """Charge what reading a file takes. Raises SolariError for a header that says more than the file can have."""
    header = _HEADER.match(data)
    if header is None:
        raise SolariError(f"{who}: its header is missing or too long: export it again")
    counts, properties = list[int](), list[int]()
    for line in _LINE.finditer(header[0]):
        if line[1]:
            counts.append(int(line[1]))
            properties.append(0)
        elif properties:
            properties[-1] += 1
    if len(counts) > _MOST_ELEMENTS or sum(properties) > _MOST_PROPERTIES:
        raise SolariError(
            f"{who}: has {len(counts)} elements and {sum(properties)} properties; at most "
            f"{_MOST_ELEMENTS} and {_MOST_PROPERTIES} are read: leave out what isn't needed"
        )
    values = sum(count * max(width, 1) for count, width in zip(counts, properties, strict=True))
    if values > len(data):
        raise SolariError(f"{who}: says that it has {values:,} values, but has {len(data):,} bytes: export it again")
    if b"ascii" in header[0][:100]:
        lines = data[header.end() :].split(b"\n")
        start, uneven = 0, 0
        for count, width in zip(counts, properties, strict=True):
            if len({len(line.split()) for line in lines[start : start + count]}) > 1:
                uneven += count * width
            start += count
        charge(_BYTES_PER_LINE * len(lines) + _BYTES_PER_VALUE * uneven, who, "its lines")
