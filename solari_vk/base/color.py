"""Numbers of linear Rec. 709, the color space of all radiance, and the transfer function of sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""The luminance of red, green and blue."""

# IEC 61966-2-1: linear up to the knee, then SCALE x^(1 / GAMMA) - OFFSET.
SRGB_KNEE = 0.0031308
SRGB_SLOPE = 12.92
SRGB_SCALE = 1.055
SRGB_OFFSET = 0.055
SRGB_GAMMA = 2.4
SRGB_ENCODED_KNEE = 0.04045


def decode_srgb(encoded: ArrayLike) -> NDArray[np.float32]:
    """The inverse of `output.tone_mapping.encode_srgb`: encoded [0, 1] to linear [0, 1]."""
    x = np.clip(np.asarray(encoded, np.float64), 0, 1)
    curved = ((x + SRGB_OFFSET) / SRGB_SCALE) ** SRGB_GAMMA
    return np.where(x <= SRGB_ENCODED_KNEE, x / SRGB_SLOPE, curved).astype(np.float32)


def glsl_header() -> str:
    """`generated/base/color.glsl`: LUMINANCE_WEIGHTS."""
    return f"const vec3 LUMINANCE_WEIGHTS = vec3{LUMINANCE_WEIGHTS};"
