"""Whether an EXR picture was written to its end: the OpenEXR library neither reports that it wasn't, nor refuses it."""

from __future__ import annotations

import struct

import numpy as np

# Of a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
_NO_SCANLINES = 0x1A00  # flags of files with tiles, with deep data, and with several parts


def is_whole(data: bytes) -> bool:
    """Whether the content of a file has all of its scanlines. Files of other kinds aren't looked at: True.

    "OpenEXR File Layout" (openexr.com): the header's attributes, the offsets of the chunks, and the chunks.
    """
    try:
        if struct.unpack_from("<I", data, 4)[0] & _NO_SCANLINES:
            return True
        attributes, place = {}, 8
        while data[place]:
            name_end = data.index(0, place)
            kind_end = data.index(0, name_end + 1)
            (size,) = struct.unpack_from("<I", data, kind_end + 1)
            start, end = kind_end + 5, kind_end + 5 + size
            attributes[data[place:name_end]], place = data[start:end], end
        _, top, _, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
        compression = attributes[b"compression"][0]
        if compression >= len(_LINES):
            return True
        count = -((top - bottom - 1) // _LINES[compression])
        offsets = np.frombuffer(data, "<u8", count, place + 1)
        last = int(offsets.max())
        _, size = struct.unpack_from("<iI", data, last)
        return bool(offsets.all()) and last + 8 + size <= len(data)
    except (struct.error, IndexError, KeyError, ValueError):
        return False
