"""Antialiasing and upscaling: the picture from samples at different positions, over frames; glsl/passes/taa/."""

from __future__ import annotations

import math

from solari_vk.gpu.frame.stages import Aliased, Counter, History, Pass, Stage
from solari_vk.gpu.shaders.headers import constants
from solari_vk.passes.paths import is_sparse
from solari_vk.settings import Settings

Size = tuple[int, int]
CELL_SIZE = 4  # width in rendered pixels of a cell whose samples are compared with those of the previous frame


def render_size(size: Size, settings: Settings) -> Size:
    """The size that is rendered for a picture of this size: the picture's over `upscale`, rounded up, if the denoiser
    doesn't fill the pixels without a path."""
    return size if is_sparse(settings) else divided(size, settings.upscale)


def divided(size: Size, upscale: float) -> Size:
    """The size over `upscale`, rounded up."""
    width, height = size
    return math.ceil(width / upscale), math.ceil(height / upscale)


def jitter_count(settings: Settings) -> int:
    """The number of frames after which sample positions repeat: 32 in each pixel of the picture."""
    # A rendered pixel covers upscale**2 of the picture's, and each of these needs its share of the positions.
    return round(32 * settings.upscale**2)


def stage(size: Size, rendered: Size, grid: Size = (1, 1)) -> Stage:
    """Makes `radiance` of this size from `sample_radiance` of the size `rendered`. With antialiasing=off it copies or
    interpolates it. grid: columns and rows of views.

    Inputs: `sample_radiance`, `reflection_motion`, `depth`, `gbuffer_surface`, `guides_*`, `previous_*`.
    Outputs: `radiance`, in an exposure the mean so far, and `taa_samples`. Histories and strata of pixels stay for the
    stage's next frame.
    """
    # Yang et al., "A Survey of Temporal Antialiasing Techniques" (2020).
    pixels = size[0] * size[1]
    # Each view has cells of its own.
    columns, rows = (count * -(-side // count // CELL_SIZE) for side, count in zip(rendered, grid, strict=True))
    # The denoiser's histories of the previous frame have been read by then, and lend their memory. A cell takes less
    # than the history of four pixels; but views of a few pixels have more cells, and upscaled pictures more pixels.
    cells = columns * rows
    samples = rendered[0] * rendered[1]
    changes = Aliased("previous_denoise_diffuse", cells) if 4 * cells <= samples else cells
    edges = Aliased("previous_denoise_alternate", pixels) if pixels == samples else pixels
    return Stage(
        "taa",
        buffers={
            "taa_history": History(pixels),
            "radiance": pixels,
            "taa_samples": History(samples),
            "taa_changes": changes,
            "taa_confidence": cells,
            "taa_edges": edges,
            "taa_coverage": Counter(1),
            "taa_strata": pixels if size == rendered else 1,  # upscaled pictures have none
        },
        passes=[
            Pass("taa/change", threads=(columns * CELL_SIZE, rows * CELL_SIZE)),
            Pass("taa/confidence", threads=(columns, rows)),
            Pass("taa/find_edges", threads=size),
            Pass("taa/begin_coverage", threads=1),
            Pass("taa/coverage", indirect="taa_coverage"),
            Pass("taa/resolve", threads=size),
        ],
    )


def glsl_header() -> str:
    """`const uint CELL_SIZE = 4u;`"""
    return constants(CELL_SIZE=CELL_SIZE)
