"""Pictures from files, as 8-bit RGBA, and their mip chains."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import ktx2

Pixels = NDArray[np.uint8]
LARGEST_SIDE = 16_384
LARGEST_PIXEL_COUNT = 2**27  # of one image: 512 MiB as RGBA
LARGEST_TOTAL_PIXEL_COUNT = 2**30  # of one model: 4 GiB as RGBA


def open_image(data: bytes | memoryview, who: str) -> Any:
    """Open an image and check its header; `decode` reads the pixels. `who` names the image in errors."""
    image = ktx2.Ktx2Image(bytes(data), who) if data[:12] == ktx2.IDENTIFIER else _open_by_pillow(data, who)
    if max(image.width, image.height) > LARGEST_SIDE or image.width * image.height > LARGEST_PIXEL_COUNT:
        raise SolariError(_too_large(who, f"has {image.width} x {image.height} pixels; "))
    return image


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
            gray = np.asarray(image).astype(np.uint32)
            pixels = np.full((*gray.shape, 4), 255, np.uint8)
            pixels[..., :3] = ((gray * 255 + 32_767) // 65_535)[..., None]
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


# ---- mip chains -------------------------------------------------------------------------------------


def _srgb_to_linear() -> NDArray[np.float32]:
    value = np.arange(256) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


LINEAR_OF_SRGB = _srgb_to_linear()
# The sRGB codes of 2^16 linear values: fine enough that every 8-bit code is reproduced.
_STEPS = 2**16 - 1
_MIDDLES = ((LINEAR_OF_SRGB[1:].astype(np.float64) + LINEAR_OF_SRGB[:-1]) / 2 * _STEPS).astype(np.float32)
_SRGB_OF_LINEAR = np.searchsorted(_MIDDLES, np.arange(_STEPS + 1)).astype(np.uint8)


def mip_chain(pixels: Pixels, srgb: bool) -> list[Pixels]:
    """The levels of an image (h, w, 4), from itself down to 1 x 1.

    Sizes are halved rounding down, and every pixel is the exact average of the area it covers, also where a
    size is odd. Colors of sRGB images are averaged as light; alpha and all other images as they are.
    """
    levels = [np.ascontiguousarray(pixels, np.uint8)]
    height, width = pixels.shape[:2]
    light = _to_light(levels[0], srgb) if max(height, width) > 1 else np.empty(0, np.float32)
    while max(height, width) > 1:
        light = _halve(_halve(light, 0), 1)
        height, width = light.shape[:2]
        levels.append(_from_light(light, srgb))
    return levels


def _to_light(pixels: Pixels, srgb: bool) -> NDArray[np.float32]:
    if not srgb:
        return pixels.astype(np.float32)
    light = np.take(LINEAR_OF_SRGB, pixels)
    light *= _STEPS
    light[..., 3] = pixels[..., 3]
    return light


def _from_light(light: NDArray[np.float32], srgb: bool) -> Pixels:
    rounded = light + np.float32(0.5)
    if not srgb:
        return rounded.astype(np.uint8)
    pixels = np.take(_SRGB_OF_LINEAR, rounded.astype(np.uint16))
    pixels[..., 3] = rounded[..., 3]
    return pixels


def _halve(light: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Average along an axis to half the size, rounded down; size 1 stays."""
    size = light.shape[axis]
    if size == 1:
        return light
    light = np.moveaxis(light, axis, 0)
    half = size // 2
    even, odd = light[0 : 2 * half : 2], light[1 : 2 * half : 2]
    if size % 2 == 0:
        result = (even + odd) * np.float32(0.5)
    else:
        # Each result covers 2 + 1/half pixels: three pixels, weighted by their overlap.
        index = np.arange(half, dtype=np.float32).reshape(-1, *[1] * (light.ndim - 1))
        result = (even * (half - index) + odd * np.float32(half) + light[2::2] * (index + 1)) / np.float32(size)
    return np.moveaxis(result, 0, axis)
