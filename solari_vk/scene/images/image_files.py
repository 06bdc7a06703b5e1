"""Pictures from files, as 8-bit RGBA: PNG, JPEG, WebP, DDS and more by Pillow, KTX2 and EXR."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_regular
from solari_vk.scene.images import exr, ktx2
from solari_vk.scene.images.mip_chain import srgb_of_linear

Pixels = NDArray[np.uint8]
LARGEST_SIDE = 16_384
LARGEST_PIXEL_COUNT = 2**27  # of one image: 512 MiB as RGBA
_BYTES_PER_PIXEL = 8  # RGBA, and what it is decoded to
_WORKING_BYTES = 12  # of a pixel, while it is decoded
_WORKING_BYTES_OF = {"WEBP": 20, "DDS": 40, "EXR": 40}
_BYTE_OF_16_BITS = np.rint(np.arange(2**16) / 257).astype(np.uint8)


_FORMATS = ("PNG", "JPEG", "WEBP", "DDS")
MORE_FORMATS = ("BMP", "GIF", "TIFF", "TGA")  # of programs that write OBJ; glTF has none of them


def open_image(data: bytes | memoryview, who: str, more: tuple[str, ...] = ()) -> Any:
    """Open an image, check its header and charge its pixels; `decode` reads them. `who` names the image in errors.
    more: further formats of Pillow."""
    image: Any
    # By content, not by suffix: glTF files name their images wrongly often enough.
    if data[:12] == ktx2.IDENTIFIER:
        image = ktx2.Ktx2Image(bytes(data), who)
    elif data[:12] == ktx2.IDENTIFIER_OF_KTX_1:
        raise SolariError(
            f"{who} is a KTX 1 file, which isn't read: convert it by ktx2ktx2 (of KTX-Software), or save it as PNG"
        )
    elif data[:4] == exr.IDENTIFIER:
        image = exr.ExrImage(bytes(data), who)
    else:
        image = _open_by_pillow(data, who, (*_FORMATS, *more))
    if max(image.width, image.height) > LARGEST_SIDE or image.width * image.height > LARGEST_PIXEL_COUNT:
        raise SolariError(_too_large(who, f"has {image.width} x {image.height} pixels; "))
    count = image.width * image.height
    text = f"the image of {image.width} x {image.height} pixels"
    charge(_BYTES_PER_PIXEL * count, who, text, working=working_bytes(image))
    return image


def read_pixels(path: str | os.PathLike[str], data: bytes | None = None) -> Pixels:
    """The pixels (height, width, 4) of a file. data: its content, if that is read already.

    Raises SolariError for a file that is missing, damaged or too large.
    """
    who = os.fspath(path)
    with load_budget():
        found = read_regular(Path(who), who) if data is None else data
        return decode(open_image(found, who, MORE_FORMATS), who)


def working_bytes(image: Any) -> int:
    """The bytes that decoding an opened image takes beside the pixels."""
    kind = "EXR" if isinstance(image, exr.ExrImage) else getattr(image, "format", "")
    chunks = getattr(image, "working_bytes", 0)  # of EXR pictures
    return int(_WORKING_BYTES_OF.get(kind, _WORKING_BYTES) * image.width * image.height) + chunks


def _open_by_pillow(data: bytes | memoryview, who: str, formats: tuple[str, ...]) -> Any:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # The limits below replace Pillow's warning.
            warnings.simplefilter("ignore")
            return Image.open(io.BytesIO(data), formats=formats)
    except UnidentifiedImageError:
        *others, last = ("PNG", "JPEG", "WebP", "KTX2", "DDS", "EXR", *formats[len(_FORMATS) :])
        raise SolariError(
            f"{who} is not a {', '.join(others)} or {last} image, or is damaged: save it again as one of these"
        ) from None
    except (Image.DecompressionBombError, MemoryError):
        raise SolariError(_too_large(who)) from None
    except Exception as error:  # Pillow raises many types of exceptions for damaged headers
        raise SolariError(f"{who} is a damaged image ({_short(error)}): save it again") from None


def decode(image: Any, who: str, *, linear: bool = False) -> Pixels:
    """The pixels (height, width, 4) of an opened image; 16-bit values are rounded to 8, no color profile applied.

    The values of EXR images, which are floating-point numbers, are clipped to [0, 1]. Their colors become sRGB codes,
    as all others are; with `linear` they are data, such as normals, and stay linear.
    """
    try:
        if isinstance(image, ktx2.Ktx2Image):
            return image.decode(who)
        if isinstance(image, exr.ExrImage):
            return _codes(image.colors(who), linear)
        if image.format == "DDS":
            return _decode_dds(image, who)
        if image.mode == "F":
            raise SolariError(f"{who} has floating-point numbers: save it with 8 or 16 bits a channel, or as EXR")
        if image.mode in ("I;16", "I;16B", "I;16L", "I"):
            # Pillow's own conversion of 16-bit gray to RGBA clips at 255.
            # _BYTE_OF_16_BITS divides by 257, which maps 65535 to 255.
            gray = np.asarray(image)
            pixels = np.full((*gray.shape, 4), 255, np.uint8)
            pixels[..., :3] = np.take(_BYTE_OF_16_BITS, gray, mode="clip")[..., None]
            return pixels
        return np.asarray(image if image.mode == "RGBA" else image.convert("RGBA"))
    except SolariError:
        raise
    except MemoryError:
        raise SolariError(_too_large(who)) from None
    except Exception as error:  # Pillow raises many types of exceptions for damaged pixels too
        raise SolariError(f"{who} is a damaged image ({_short(error)}): save it again") from None


def _decode_dds(image: Any, who: str) -> Pixels:
    """The pixels (height, width, 4) of the largest level of a DDS file (DirectDraw Surface) that Pillow has opened.

    BC5 has two channels, of normals: the third completes them to unit length. Raises SolariError for BC6H, whose values
    are floating-point numbers.
    """
    form = getattr(image, "pixel_format", None) or ""
    if form.startswith("BC6H"):
        raise SolariError(f"{who} is a DDS image of the format BC6H: save it with 8 bits a channel, or as EXR")
    if image.tile[0].codec_name == "dds_rgb":
        return _decode_masked_dds(image, who)
    pixels = np.array(image if image.mode == "RGBA" else image.convert("RGBA"))
    if form.startswith("BC5"):
        # Codes 0 to 255 are -1 to 1. z of a unit normal follows from x and y, and points outwards.
        x, y = np.moveaxis(pixels[..., :2] / np.float32(127.5) - 1, -1, 0)
        pixels[..., 2] = np.rint((np.sqrt(np.clip(1 - x * x - y * y, 0, 1)) + 1) * 127.5)
    return pixels


def _decode_masked_dds(image: Any, who: str) -> Pixels:
    """The pixels of an uncompressed image, whose channels are bits of whole numbers. Pillow reads them one by one."""
    bits, masks = image.tile[0].args
    size = image.width * image.height * (bits // 8)
    data = image.fp.read(size)
    if bits not in (8, 16, 24, 32) or len(data) < size:
        raise SolariError(f"{who} is a damaged DDS image: save it again")
    # Whole numbers with the lowest byte first, of which each channel has the bits of its mask.
    places = np.frombuffer(data, np.uint8).reshape(image.height, image.width, bits // 8)
    number = sum(places[..., byte].astype(np.uint32) << np.uint32(8 * byte) for byte in range(bits // 8))
    pixels = np.full((image.height, image.width, 4), 255, np.uint8)
    for channel, mask in enumerate(masks):
        pixels[..., channel] = np.rint((number & np.uint32(mask)) * (255 / mask)) if mask else 0
    return pixels


def _codes(values: NDArray[np.float32], linear: bool) -> Pixels:
    """The pixels (H, W, 4) of linear values (H, W, 3 or 4); NaN is 0."""
    # Infinity becomes 1 by clipping.
    light = np.nan_to_num(values, nan=0.0).clip(0, 1)
    pixels = np.full((*light.shape[:2], 4), 255, np.uint8)
    pixels[..., : light.shape[2]] = np.rint(light * 255)
    if not linear:
        pixels[..., :3] = srgb_of_linear(light[..., :3])
    return pixels


def _too_large(who: str, size: str = "is too large; ") -> str:
    return (
        f"{who} {size}at most {LARGEST_SIDE} a side and {LARGEST_PIXEL_COUNT >> 20} Mi pixels in all are read: "
        "scale it down"
    )


def _short(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:100]
