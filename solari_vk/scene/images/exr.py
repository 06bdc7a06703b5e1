"""Whether an EXR picture was written to its end: the OpenEXR library neither reports that it wasn't, nor refuses it."""

from __future__ import annotations

import struct

import numpy as np

# Of a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K
# with 256 and with 32, LJ2K, and ZSTD.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
_TILED, _DEEP, _SEVERAL_PARTS = 0x200, 0x800, 0x1000


def is_whole(data: bytes) -> bool:
    """Whether the content of a file has all of its scanlines or tiles.

    Files with deep data, several parts, several levels or unknown compressions aren't looked at: True. The layout,
    "OpenEXR File Layout" (openexr.com): the header's attributes, the offsets of the chunks, and the chunks.
    """
    try:
        (flags,) = struct.unpack_from("<I", data, 4)
        if flags & (_DEEP | _SEVERAL_PARTS):
            return True
        attributes, place = {}, 8
        while data[place]:
            name_end = data.index(0, place)
            kind_end = data.index(0, name_end + 1)
            (size,) = struct.unpack_from("<I", data, kind_end + 1)
            start, end = kind_end + 5, kind_end + 5 + size
            attributes[data[place:name_end]], place = data[start:end], end
        left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
        width, height, compression = right - left + 1, bottom - top + 1, attributes[b"compression"][0]
        if flags & _TILED:
            tile_width, tile_height, levels = struct.unpack("<IIB", attributes[b"tiles"])
            if levels:
                return True
            count, place_bytes = -(-width // tile_width) * -(-height // tile_height), 16
        elif compression < len(_LINES):
            count, place_bytes = -(-height // _LINES[compression]), 4
        else:
            return True
        offsets = np.frombuffer(data, "<u8", count, place + 1)
        starts = offsets.astype(np.int64) + place_bytes
        sizes = np.frombuffer(data, np.uint8)[starts[:, None] + np.arange(4)].view("<u4")[:, 0]
        return bool(offsets.all()) and bool((starts + 4 + sizes <= len(data)).all())
    except (struct.error, IndexError, KeyError, ValueError, ZeroDivisionError):
        return False
