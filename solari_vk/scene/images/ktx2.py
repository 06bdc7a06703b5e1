"""Pictures in KTX 2.0 files (Khronos): Basis Universal, as in KHR_texture_basisu, and plain 8-bit pixels."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.libraries import library, zstd

IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
IDENTIFIER_OF_KTX_1 = b"\xabKTX 11\xbb\r\n\x1a\n"
# Channels of a pixel by VkFormat, in the order of the file: UNORM and SRGB.
_CHANNELS = {
    9: "r", 15: "r", 16: "rg", 22: "rg", 23: "rgb", 29: "rgb", 30: "bgr", 36: "bgr", 37: "rgba", 43: "rgba",
    44: "bgra", 50: "bgra",
}  # fmt: skip
_NONE, _BASIS_LZ, _ZSTD, _ZLIB = range(4)
_BLOCK_BYTES = 16  # of 4 x 4 pixels in UASTC


class Ktx2Image:
    """An opened file: its header, from which `decode` reads the largest level."""

    def __init__(self, data: bytes, who: str) -> None:
        """Raises SolariError for what isn't one picture in a format that can be read. who: names it in errors."""
        if len(data) < 104:
            raise SolariError(f"{who} is a truncated KTX2 file: copy it again")
        # KTX 2.0, section 3: after the identifier nine numbers, then the index of the sections, then the levels.
        header = struct.unpack_from("<9I", data, 12)
        self._format, _, self.width, self.height, depth, layers, faces, _, self._scheme = header
        if depth or layers > 1 or faces != 1 or not (self.width and self.height):
            raise SolariError(
                f"{who} is a KTX2 file with {depth} slices, {layers} layers and {faces} faces: save one picture alone"
            )
        if (self._format and self._format not in _CHANNELS) or self._scheme > _ZLIB:
            raise SolariError(
                f"{who} is a KTX2 file of the VkFormat {self._format} with the compression "
                f"{self._scheme}: save it with 8 bits a channel or as Basis Universal"
            )
        # The first entry is the largest level: its place, its size, and its size without compression.
        start, size, self._plain_size = struct.unpack_from("<3Q", data, 80)
        if start + size > len(data):
            raise SolariError(f"{who} is a truncated KTX2 file: copy it again")
        self._level = data[start : start + size]
        self._data = data

    def decode(self, who: str) -> NDArray[np.uint8]:
        """The pixels (height, width, 4); channels that the file lacks are those of Vulkan, 0 and for alpha 255."""
        return self._plain_pixels(who) if self._format else self._basis_pixels(who)

    def _basis_pixels(self, who: str) -> NDArray[np.uint8]:
        blocks = -(-self.width // 4) * -(-self.height // 4)
        # UASTC has 16 bytes for each 4 x 4 pixels, known before anything is expanded.
        if self._scheme != _BASIS_LZ and self._plain_size > blocks * _BLOCK_BYTES:
            raise SolariError(f"{who} is a KTX2 file that expands to more than its size: save it again")
        opengl_basisu = library("opengl_basisu", f"{who} (Basis Universal)")
        try:
            pixels: NDArray[np.uint8] = opengl_basisu.open(self._data).transcode("rgba8").data
        except opengl_basisu.BasisuError as error:
            raise SolariError(f"{who} is a damaged KTX2 file ({error}): save it again") from None
        return pixels

    def _plain_pixels(self, who: str) -> NDArray[np.uint8]:
        channels = _CHANNELS[self._format]
        size = self.width * self.height * len(channels)
        data = _expanded(self._level, size, self._scheme, who)
        if len(data) != size:
            raise SolariError(f"{who} is a KTX2 file with {len(data)} bytes of pixels instead of {size}: save it again")
        stored = np.frombuffer(data, np.uint8).reshape(self.height, self.width, len(channels))
        pixels = np.zeros((self.height, self.width, 4), np.uint8)
        pixels[..., 3] = 255
        pixels[..., ["rgba".index(channel) for channel in channels]] = stored
        return pixels


def _expanded(level: bytes, size: int, scheme: int, who: str) -> bytes:
    """The bytes of a level; at most one more than `size`, whatever the file expands to."""
    if scheme == _NONE:
        return level
    expander, error = _expander(scheme, who)
    try:
        return bytes(expander.decompress(level, size + 1))
    except error as reason:
        raise SolariError(f"{who} is a damaged KTX2 file ({reason}): save it again") from None


def _expander(scheme: int, who: str) -> tuple[Any, type[Exception]]:
    """What decompresses a scheme, and the exception for damaged data."""
    if scheme == _ZLIB:
        return zlib.decompressobj(), zlib.error
    module = zstd(who)
    return module.ZstdDecompressor(), module.ZstdError
