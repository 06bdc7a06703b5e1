"""Pictures in DDS files (DirectDraw Surface), which Pillow opens: what it leaves to its users."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError

Pixels = NDArray[np.uint8]


def decode(image: Any, who: str) -> Pixels:
    """The pixels (height, width, 4) of the largest level of an opened image.

    BC5 has two channels, of normals: the third completes them to unit length. Raises SolariError for BC6H, whose values
    are floating-point numbers.
    """
    form = getattr(image, "pixel_format", None) or ""
    if form.startswith("BC6H"):
        raise SolariError(f"{who} is a DDS image of the format BC6H: save it with 8 bits a channel, or as EXR")
    if image.tile[0].codec_name == "dds_rgb":
        return _masked(image, who)
    pixels = np.array(image if image.mode == "RGBA" else image.convert("RGBA"))
    if form.startswith("BC5"):
        x, y = np.moveaxis(pixels[..., :2] / np.float32(127.5) - 1, -1, 0)
        pixels[..., 2] = np.rint((np.sqrt(np.clip(1 - x * x - y * y, 0, 1)) + 1) * 127.5)
    return pixels


def _masked(image: Any, who: str) -> Pixels:
    """The pixels of an uncompressed image, whose channels are bits of whole numbers. Pillow reads them one by one."""
    bits, masks = image.tile[0].args
    size = image.width * image.height * (bits // 8)
    data = image.fp.read(size)
    if bits not in (8, 16, 24, 32) or len(data) < size:
        raise SolariError(f"{who} is a damaged DDS image: save it again")
    places = np.frombuffer(data, np.uint8).reshape(image.height, image.width, bits // 8)
    number = sum(places[..., byte].astype(np.uint32) << np.uint32(8 * byte) for byte in range(bits // 8))
    pixels = np.full((image.height, image.width, 4), 255, np.uint8)
    for channel, mask in enumerate(masks):
        pixels[..., channel] = np.rint((number & np.uint32(mask)) * (255 / mask)) if mask else 0
    return pixels
