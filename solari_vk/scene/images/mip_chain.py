"""Mip chains of 8-bit pictures, averaged as light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import decode_srgb

Pixels = NDArray[np.uint8]


LINEAR_OF_SRGB = decode_srgb(np.arange(256) / 255)
# The sRGB codes of 2^16 linear values: fine enough that every 8-bit code is reproduced.
_STEPS = 2**16 - 1
_MIDDLES = ((LINEAR_OF_SRGB[1:].astype(np.float64) + LINEAR_OF_SRGB[:-1]) / 2 * _STEPS).astype(np.float32)
CODE_OF_LIGHT = np.searchsorted(_MIDDLES, np.arange(_STEPS + 1)).astype(np.uint8)
LIGHT_OF_CODE = LINEAR_OF_SRGB * np.float32(_STEPS)


def srgb_of_linear(light: NDArray[np.floating[Any]]) -> Pixels:
    """The sRGB codes of linear values in [0, 1]."""
    codes: Pixels = CODE_OF_LIGHT[np.rint(light * _STEPS).astype(np.uint16)]
    return codes


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
    light = np.take(LIGHT_OF_CODE, pixels)
    light[..., 3] = pixels[..., 3]
    return light


def _from_light(light: NDArray[np.float32], srgb: bool) -> Pixels:
    # Casts to integers cut off.
    rounded = light + np.float32(0.5)
    if not srgb:
        return rounded.astype(np.uint8)
    pixels = np.take(CODE_OF_LIGHT, rounded.astype(np.uint16))
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
