"""Debug views of one part of the frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ViewGroup:
    """Views of one part of the frame.

    views: for each name what the view shows, and a GLSL expression of type vec3 for the sRGB color of a pixel. The
    expression knows `uvec2 pixel`, `ivec2 at` (the same), `uint index` (of the pixel in buffers) and
    `GBufferSurface surface`, and what `setup`, statements that run first, declares. lighting: the one that has these
    views, by its name in `Settings`; empty for views that every lighting has.
    """

    title: str
    setup: str
    views: dict[str, tuple[str, str]]
    lighting: str = ""


IF_SURFACE = "if (!surface.exists) { return NOTHING; }"
"""A setup for views of surfaces alone."""
