"""Pictures in EXR files, and what the OpenEXR library doesn't check: whether one was written to its end, and how large
its chunks are."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError

IDENTIFIER = b"\x76\x2f\x31\x01"
_COPIES_OF_CHUNKS = 3  # packed, unpacked, and by channels

# Of a chunk, by the number of the compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K
# with 256 and with 32, LJ2K, and ZSTD.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
_HALF = 1
# Flags of the file's version field.
_TILED = 0x200
_DEEP = 0x800
_SEVERAL_PARTS = 0x1000


class ExrImage:
    """An opened picture: its header, from which `colors` reads the pixels.

    working_bytes: that the library takes for the tiles or lines while it reads them.
    """

    def __init__(self, data: bytes, who: str) -> None:
        """Charges `working_bytes`. Raises SolariError for a damaged header. who: names the picture in errors."""
        try:
            _, attributes, _ = _header(data)
            left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
            self._channels = [name.decode() for name, _ in _channels(attributes[b"channels"])]
        except (struct.error, IndexError, KeyError, ValueError) as error:
            raise _damaged(who, error) from None
        # The data window is given by its first and its last pixel.
        self.width = right - left + 1
        self.height = bottom - top + 1
        self._data = data
        if min(self.width, self.height) < 1:
            raise SolariError(f"{who} is an EXR picture without pixels: save it again")
        self.working_bytes = _COPIES_OF_CHUNKS * chunk_bytes(data)
        charge(0, who, "the tiles or lines", working=self.working_bytes)

    def colors(self, who: str) -> NDArray[np.float32]:
        """Linear colors (height, width, 3), 4 with alpha. Raises SolariError for a picture that is damaged, cut off, or
        without the channels of colors or gray."""
        import Imath
        import OpenEXR

        names = ["R", "G", "B"] if "R" in self._channels else ["Y", "Y", "Y"]
        if not all(name in self._channels for name in names):
            raise SolariError(f"{who} has no channels R, G and B, nor Y, but {', '.join(sorted(self._channels)[:8])}")
        if not is_whole(self._data):
            raise _damaged(who, "it is cut off")
        try:
            # This interface reads from memory; the newer one, OpenEXR.File, from paths alone.
            picture = OpenEXR.InputFile(BytesIO(self._data))
            kind = Imath.PixelType(Imath.PixelType.FLOAT)
            size = (self.height, self.width)
            every = [*names, "A"] if "A" in self._channels else names
            values = [np.frombuffer(picture.channel(name, kind), np.float32).reshape(size) for name in every]
            return np.stack(values, axis=-1)
        except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
            raise _damaged(who, error) from None


def _damaged(who: str, reason: object) -> SolariError:
    return SolariError(f"{who} is a damaged EXR picture ({str(reason)[:100]}): save it again")


def chunk_bytes(data: bytes) -> int:
    """The bytes of a chunk of lines or of a row of tiles, all channels, which the library takes whatever it holds."""
    try:
        flags, attributes, _ = _header(data)
        left, _, right, _ = struct.unpack("<4i", attributes[b"dataWindow"])
        pixel_bytes = sum(2 if kind == _HALF else 4 for _, kind in _channels(attributes[b"channels"]))
        width = right - left + 1
        lines = max(_LINES)
        if flags & _TILED:
            tile_width, lines = struct.unpack_from("<II", attributes[b"tiles"])
            width = -(-width // tile_width) * tile_width
        elif attributes[b"compression"][0] < len(_LINES):
            lines = _LINES[attributes[b"compression"][0]]
        return int(width * lines * pixel_bytes)
    except (struct.error, IndexError, KeyError, ValueError, ZeroDivisionError):
        return 0  # damaged, or of several parts


def _channels(attribute: bytes) -> Iterator[tuple[bytes, int]]:
    """The names of the channels, and the numbers of their types."""
    place = 0
    while attribute[place]:
        end = attribute.index(0, place)
        yield attribute[place:end], attribute[end + 1]
        # After the name and a zero come the type, a flag, three reserved bytes and two sampling steps: 16 bytes.
        place = end + 17


def _header(data: bytes) -> tuple[int, dict[bytes, bytes], int]:
    """The flags, the attributes by name, and where they end. Raises an error for a damaged one."""
    (flags,) = struct.unpack_from("<I", data, 4)
    attributes = {}
    place = 8  # after the magic number and the flags
    while data[place]:
        name_end = data.index(0, place)
        kind_end = data.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", data, kind_end + 1)
        start = kind_end + 5  # after a zero and the size
        end = start + size
        attributes[data[place:name_end]] = data[start:end]
        place = end
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
        width, height = right - left + 1, bottom - top + 1
        compression = attributes[b"compression"][0]
        if flags & _TILED:
            tile_width, tile_height, levels = struct.unpack("<IIB", attributes[b"tiles"])
            if levels:
                return True
            count = -(-width // tile_width) * -(-height // tile_height)
            place_bytes = 16  # the tile's column and row, and its level in both directions
        elif compression < len(_LINES):
            count = -(-height // _LINES[compression])
            place_bytes = 4  # the chunk's first line
        else:
            return True
        # The table says where each chunk starts. Writers fill it in last: a file that was cut off has zeros.
        offsets = np.frombuffer(data, "<u8", count, place + 1)
        starts = offsets.astype(np.int64) + place_bytes
        # Each chunk begins with its place, and the size of its data in 32 bits.
        sizes = np.frombuffer(data, np.uint8)[starts[:, None] + np.arange(4)].view("<u4")[:, 0]
        return bool(offsets.all()) and bool((starts + 4 + sizes <= len(data)).all())
    except (struct.error, IndexError, KeyError, ValueError, ZeroDivisionError):
        return False
