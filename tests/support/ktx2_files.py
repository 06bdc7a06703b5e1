"""KTX2 files for tests: of Basis Universal, and of plain pixels."""

import base64
import struct
import zlib

import numpy as np

from solari_vk.scene.files.libraries import zstd

# Written by the encoder of Basis Universal 2.10. 8 x 4 pixels: left (200, 40, 40, 255), right (40, 40, 200, 128).
ETC1S = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAABAAAAaAAAADwAAACkAAAAJAAAAMgAAAAAAAAAkgAA"
    "AAAAAABaAQAAAAAAAAIAAAAAAAAAAAAAAAAAAAA8AAAAAAAAAAIAOACjAQIAAwMAAAgIAAAAAAAAAAA/AAAAAAAAAAAA/////0AA"
    "Pw8AAAAAAAAAAP////8fAAAAS1RYd3JpdGVyAEJhc2lzIFVuaXZlcnNhbCAyLjEwAAAEAAMAMQAAAA0AAAAsAAAAAAAAAAAAAAAA"
    "AAAAAQAAAAEAAAABAAAAFMBEAAAAAAAA4gEIMBEAAAAAAIAsOLABTAkAAAAAAEGR5AERgCgAAgAAAJAY4EOuAFRVVVUFAAAAqKqq"
    "qgIAwUQAAAAAAADyX40AmAAQAAAAAECUAJgAIAAAAACB4gBgAgAAAAAAAAEEAHYI"
)
UASTC_ZSTD = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAACAAAAaAAAACwAAACUAAAAJAAAAAAAAAAAAAAAAAAA"
    "AAAAAAC4AAAAAAAAACkAAAAAAAAAIAAAAAAAAAAsAAAAAAAAAAIAKACmAQIAAwMAABAAAAAAAAAAAAB/AwAAAAAAAAAA/////x8A"
    "AABLVFh3cml0ZXIAQmFzaXMgVW5pdmVyc2FsIDIuMTAAACi1L/0gIAEBABcZBeU/yMYAAAAAAAAAAAAXBQUZMDAmAwAAAAAAAAAA"
)
UASTC = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAAAAAAAaAAAACwAAACUAAAALAAAAAAAAAAAAAAAAAAA"
    "AAAAAADAAAAAAAAAACAAAAAAAAAAIAAAAAAAAAAsAAAAAAAAAAIAKACmAQIAAwMAABAAAAAAAAAAAAB/AwAAAAAAAAAA/////x8A"
    "AABLVFh3cml0ZXIAQmFzaXMgVW5pdmVyc2FsIDIuMTAAAAQAAAB/fwAAFxkF5T/IxgAAAAAAAAAAABcFBRkwMCYDAAAAAAAAAAA="
)


def plain(pixels, vk_format, scheme=0, level=None, **fields):
    """A file of 8-bit pixels (height, width, channels). level: other bytes for them. fields: of the header."""
    pixels = np.asarray(pixels, np.uint8)
    data = pixels.tobytes() if level is None else level
    if scheme:
        data = zlib.compress(data) if scheme == 3 else zstd("tests").compress(data)
    height, width = pixels.shape[:2]
    header = {
        "format": vk_format,
        "type_size": 1,
        "width": width,
        "height": height,
        "depth": 0,
        "layers": 0,
        "faces": 1,
        "levels": 1,
        "scheme": scheme,
        **fields,
    }
    index = struct.pack("<4I2Q", 0, 0, 0, 0, 0, 0) + struct.pack("<3Q", 104, len(data), pixels.nbytes)
    return b"\xabKTX 20\xbb\r\n\x1a\n" + struct.pack("<9I", *header.values()) + index + data
