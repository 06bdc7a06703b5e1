"""Pictures from files, as 8-bit RGBA."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.budget import charge
from solari_vk.errors import SolariError
from solari_vk.scene.images import ktx2

Pixels = NDArray[np.uint8]
LARGEST_SIDE = 16_384
LARGEST_PIXEL_COUNT = 2**27  # of one image: 512 MiB as RGBA
_BYTES_PER_PIXEL = 8  # RGBA, and what it is decoded to
_WORKING_BYTES, _WORKING_BYTES_OF_WEBP = 12, 20  # of a pixel, while it is decoded
_BYTE_OF_16_BITS = np.rint(np.arange(2**16) / 257).astype(np.uint8)


def open_image(data: bytes | memoryview, who: str) -> Any:
    """Open an image, check its header and charge its pixels; `decode` reads them. `who` names the image in errors."""
    image = ktx2.Ktx2Image(bytes(data), who) if data[:12] == ktx2.IDENTIFIER else _open_by_pillow(data, who)
    if max(image.width, image.height) > LARGEST_SIDE or image.width * image.height > LARGEST_PIXEL_COUNT:
        raise SolariError(_too_large(who, f"has {image.width} x {image.height} pixels; "))
    count = image.width * image.height
    text = f"the image of {image.width} x {image.height} pixels"
    charge(_BYTES_PER_PIXEL * count, who, text, working=working_bytes(image))
    return image


def working_bytes(image: Any) -> int:
    """The bytes that decoding an opened image takes beside the pixels."""
    of_webp = getattr(image, "format", "") == "WEBP"
    return int((_WORKING_BYTES_OF_WEBP if of_webp else _WORKING_BYTES) * image.width * image.height)


def _open_by_pillow(data: bytes | memoryview, who: str) -> Any:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # The limits below replace Pillow's warning.
            warnings.simplefilter("ignore")
            return Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP"))
    except UnidentifiedImageError:
        raise SolariError(
            f"{who} is not a PNG, JPEG, WebP or KTX2 image, or is damaged: save it again as one of these"
        ) from None
    except (Image.DecompressionBombError, MemoryError):
        raise SolariError(_too_large(who)) from None
    except Exception as error:  # Pillow raises many types of exceptions for damaged headers
        raise SolariError(f"{who} is a damaged image ({_short(error)}): save it again") from None


def decode(image: Any, who: str) -> Pixels:
    """The pixels (height, width, 4) of an opened image; 16-bit values are rounded to 8, no color profile applied."""
    try:
        if isinstance(image, ktx2.Ktx2Image):
            return image.decode(who)
        if image.mode in ("I;16", "I;16B", "I;16L", "I"):
            # Pillow's own conversion of 16-bit gray to RGBA clips at 255.
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


def _too_large(who: str, size: str = "is too large; ") -> str:
    return (
        f"{who} {size}at most {LARGEST_SIDE} a side and {LARGEST_PIXEL_COUNT >> 20} Mi pixels in all are read: "
        "scale it down"
    )


def _short(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:100]
