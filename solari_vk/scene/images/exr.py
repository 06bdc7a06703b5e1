"""What the OpenEXR library doesn't check: whether a picture was written to its end, and how large its chunks are."""

from __future__ import annotations

import struct

import numpy as np

# Of a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K
# with 256 and with 32, LJ2K, and ZSTD.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
_TILED, _DEEP, _SEVERAL_PARTS = 0x200, 0x800, 0x1000


def chunk_bytes(data: bytes) -> int:
    """The bytes of a chunk of lines or a tile, of all channels, which the library takes whatever it holds."""
    try:
        flags, attributes, _ = _header(data)
        left, _, right, _ = struct.unpack("<4i", attributes[b"dataWindow"])
        channels, place, pixel_bytes = attributes[b"channels"], 0, 0
        while channels[place]:
            place = channels.index(0, place) + 1
            pixel_bytes += 2 if channels[place] == 1 else 4  # half, or float and integer
            place += 16
        width, lines = right - left + 1, max(_LINES)
        if flags & _TILED:
            width, lines = struct.unpack_from("<II", attributes[b"tiles"])
        elif attributes[b"compression"][0] < len(_LINES):
            lines = _LINES[attributes[b"compression"][0]]
        return int(width * lines * pixel_bytes)
    except (struct.error, IndexError, KeyError, ValueError):
        return 0  # damaged, or of several parts


def _header(data: bytes) -> tuple[int, dict[bytes, bytes], int]:
    """The flags, the attributes by name, and where they end. Raises an error for a damaged one."""
    (flags,) = struct.unpack_from("<I", data, 4)
    attributes, place = {}, 8
    while data[place]:
        name_end = data.index(0, place)
        kind_end = data.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", data, kind_end + 1)
        start, end = kind_end + 5, kind_end + 5 + size
        attributes[data[place:name_end]], place = data[start:end], end
    return flags, attributes, place


def is_whole(data: bytes) -> bool:
    """Whether the content of a file has all of its scanlines or tiles.

    Files with deep data, several parts, several levels or unknown compressions aren't looked at: True. The layout,
    "OpenEXR File Layout" (openexr.com): the header's attributes, the offsets of the chunks, and the chunks.
    """
    try:
        if struct.unpack_from("<I", data, 4)[0] & (_DEEP | _SEVERAL_PARTS):
            return True
        flags, attributes, place = _header(data)
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
