"""The denoiser of lighting=paths; glsl/passes/denoise/.

Light is demodulated and split in two lobes. `temporal` finds each lobe's mean over frames, along the motion of
surfaces and of reflections; `sum_cells` and `find_changes` find where light changed, so that `accumulate` forgets what is
no longer true when it adds this frame's; `variance` and `blur` average over pixels, as far as differences are explained by noise.
"""

from __future__ import annotations

from solari_vk.gpu.frame.stages import History, Pass, Stage

CELL = 4  # width in pixels of a cell of `denoise_cells`
LEVELS = 5  # passes of the blur, an odd number; each is twice as wide as the one before


def stage(size: tuple[int, int]) -> Stage:
    """Denoises `paths_diffuse` and `paths_specular`; the result is in `denoise_odd`."""
    pixels = size[0] * size[1]
    cells = (-(-size[0] // CELL), -(-size[1] // CELL))
    histories = ("denoise_guides", "denoise_diffuse", "denoise_specular")
    scratch = ("denoise_even", "denoise_odd", "denoise_luminance")
    ways = ("#define SOURCE denoise_even\n#define TARGET denoise_odd", "#define SOURCE denoise_odd\n#define TARGET denoise_even")
    return Stage(
        "denoise",
        buffers={
            **dict.fromkeys(histories, History(pixels)), **dict.fromkeys(scratch, pixels),
            **dict.fromkeys(("denoise_cells", "denoise_blocks"), cells[0] * cells[1]),
        },
        passes=[
            Pass("denoise/temporal", threads=size),
            Pass("denoise/sum_cells", threads=cells),
            Pass("denoise/find_changes", threads=cells),
            Pass("denoise/accumulate", threads=size),
            Pass("denoise/variance", threads=size),
            *(Pass("denoise/blur", threads=size, constants={"level": level}, header=ways[level % 2])
              for level in range(LEVELS)),
        ],
    )  # fmt: skip
