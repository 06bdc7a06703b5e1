"""The denoiser; glsl/passes/denoise/.

Light is demodulated and split in two lobes. `reproject` finds the mean of each lobe over earlier frames, along the
motion of surfaces and of reflections. `temporal_gradient` and `history_confidence` find where light changed, so that
`accumulate`, which adds this frame's light, forgets what is no longer true. `variance` and `blur` average over pixels,
as far as differences are explained by noise. What they give isn't fed back: histories stay unblurred, so that the mean
of a still picture tends to the truth.
"""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Aliased, History, Pass, Stage
from solari_vk.gpu.shaders.headers import constants

CELL_SIZE = 4  # width in pixels of a gradient cell, an element of `denoise_cells`
LIGHT_BLOCK_SIZE = 8  # the same of a block, over which light taken from fireflies is summed: `denoise_blocks`
HISTORIES = ("denoise_guides", "denoise_diffuse", "denoise_specular", "denoise_alternate")
LEVELS = 5  # passes of the blur, each twice as wide as the one before; an odd number ends in `denoise_pong`


def history_stage(size: tuple[int, int], skips_pixels: bool = False) -> Stage:
    """Finds the history of each pixel of this frame. It comes before the paths: their number depends on it.
    skips_pixels: as of `stage`.

    Inputs: `gbuffer_surface`, `guides_*`, `previous_instances`.
    Outputs: `denoise_guides`, `denoise_diffuse`, `denoise_specular`, `denoise_alternate`.
    """
    # Surfaces as in SVGF (Schied et al. 2017), reflections as in ReBLUR (Zhdan 2021).
    pixels = size[0] * size[1]
    return Stage(
        "history",
        buffers=dict.fromkeys(HISTORIES, History(pixels)),
        passes=[Pass("denoise/reproject", threads=size, constants={"skips_pixels": skips_pixels})],
    )


def stage(
    size: tuple[int, int], grid: tuple[int, int] = (1, 1), skips_pixels: bool = False, block_width: int = 1
) -> Stage:
    """Denoises `paths_diffuse` and `paths_specular`. Does nothing when denoise=off. grid: columns and rows of views.
    skips_pixels: whether pixels may have no path in a frame; their histories stay as they are. block_width: that of
    blocks of pixels that take their paths by turns.

    `denoise_ping` and `denoise_pong` alias the memory of the previous histories, which only `denoise/reproject` reads;
    later stages alias others of them.
    Other stages ask glsl/passes/denoise/api.glsl for the result.
    Inputs: `paths_diffuse`, `paths_specular`, `guides_*_albedo`, and the history: `denoise_*`.
    Outputs: `denoise_diffuse`, `denoise_specular`, `denoise_alternate`; for this frame `denoise_pong`,
    `denoise_shares`, `denoise_gains`.
    """
    pixels = size[0] * size[1]
    skips = {"skips_pixels": skips_pixels}
    cells = _squares(size, grid, CELL_SIZE)
    blocks = _squares(size, grid, LIGHT_BLOCK_SIZE)
    return Stage(
        "denoise",
        buffers={
            **dict.fromkeys(("denoise_cells", "denoise_neighborhoods"), cells[0] * cells[1]),
            **dict.fromkeys(("denoise_blocks", "denoise_shares", "denoise_gains"), blocks[0] * blocks[1]),
            "denoise_ping": Aliased("previous_denoise_diffuse", pixels),
            "denoise_pong": Aliased("previous_denoise_specular", pixels),
        },
        passes=[
            # Where light changed: as A-SVGF (Schied, Peters and Dachsbacher 2018), but without tracing paths again.
            Pass("denoise/temporal_gradient", threads=cells, constants=skips),
            Pass("denoise/history_confidence", threads=cells),
            Pass("denoise/accumulate", threads=size, constants=skips),
            # How uncertain each mean is, and the a-trous wavelet filter (Dammertz et al. 2010) that follows from it.
            Pass("denoise/variance", threads=size, constants={"block_width": block_width}),
            # The light that it takes from fireflies is given to what is around them.
            Pass("denoise/removed_light", threads=(blocks[0] * LIGHT_BLOCK_SIZE, blocks[1] * LIGHT_BLOCK_SIZE)),
            *(
                Pass("denoise/spread_light", threads=blocks, constants={"gathers": gathers})
                for gathers in (False, True)
            ),
            *(Pass("denoise/blur", threads=size, constants={"level": level}) for level in range(LEVELS)),
        ],
    )


def reflections_stage(size: tuple[int, int]) -> Stage:
    """Finds how what smooth surfaces reflect moves, for antialiasing.

    Inputs: `sample_radiance`, `specular_radiance`, `denoise_guides`, `denoise_specular`, `gbuffer_surface`, `guides_*`,
    `previous_instances`.
    Outputs: `reflection_motion`.
    """
    pixels = size[0] * size[1]
    return Stage(
        "reflections",
        buffers={"reflection_motion": Aliased("previous_denoise_guides", pixels)},
        passes=[Pass("denoise/reflection_motion", threads=size)],
    )


def _squares(size: tuple[int, int], grid: tuple[int, int], width: int) -> tuple[int, int]:
    """Columns and rows of squares of pixels of this width. Each view has squares of its own, so that none compares the
    light of two views; its last ones may be partly outside."""
    view_width, view_height = size[0] // grid[0], size[1] // grid[1]
    return grid[0] * -(-view_width // width), grid[1] * -(-view_height // width)  # -(-a // b) rounds up


def glsl_header() -> str:
    """`const uint CELL_SIZE = 4u;` and LIGHT_BLOCK_SIZE."""
    return constants(CELL_SIZE=CELL_SIZE, LIGHT_BLOCK_SIZE=LIGHT_BLOCK_SIZE)
