"""Numbers of linear Rec. 709, the color space of all radiance."""

from __future__ import annotations

LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""The luminance of red, green and blue."""


def glsl_header() -> str:
    """`generated/base/color.glsl`: LUMINANCE_WEIGHTS."""
    return f"const vec3 LUMINANCE_WEIGHTS = vec3{LUMINANCE_WEIGHTS};"
