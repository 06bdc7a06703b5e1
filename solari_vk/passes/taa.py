"""Antialiasing and upscaling: the picture from samples at different positions, over frames; glsl/passes/taa/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import History, Pass, Stage
from solari_vk.settings import Settings

Size = tuple[int, int]


def render_size(size: Size, settings: Settings) -> Size:
    """The size that is rendered for a picture of this size: the picture's over `upscale`, rounded up."""
    return -int(-size[0] // settings.upscale), -int(-size[1] // settings.upscale)


def jitter_count(settings: Settings) -> int:
    """The number of frames after which sample positions repeat: 32 in each pixel of the picture."""
    # A rendered pixel covers upscale**2 of the picture's, and each of these needs its share of the positions.
    return round(32 * settings.upscale**2)


def stage(size: Size) -> Stage:
    """Makes `radiance` of this size from `sample_radiance`. With antialiasing=off it copies or interpolates it.

    Inputs: `sample_radiance`, `depth`, `gbuffer_surface`, `guides_*`, `previous_*`. Outputs: `radiance`;
    for the next frame `taa_history`, and in an exposure the mean so far, `radiance`.
    """
    # Yang et al., "A Survey of Temporal Antialiasing Techniques" (2020).
    pixels = size[0] * size[1]
    return Stage(
        "taa", buffers={"taa_history": History(pixels), "radiance": pixels}, passes=[Pass("taa/resolve", threads=size)]
    )
