"""The reference path tracer's stages and what its uniforms and outputs mean; glsl/passes/reference/."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, is_name, quoted
from solari_vk.gpu.frame.stages import IfUsed, Pass, Stage
from solari_vk.gpu.shaders.headers import constants, enumeration
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.passes.rows import rows as thread_rows
from solari_vk.settings.layering import LAYERINGS, brdf_constants

if TYPE_CHECKING:  # shaders are compiled with this module's header on machines without Vulkan
    from solari_vk.gpu.frame.frame import Frame
    from solari_vk.gpu.frame.uniforms import Uniforms

LARGEST_PIXEL_BYTES = 12  # of a pixel in any one buffer: three floats
DISPATCH_MS = 100.0  # target: far shorter than any driver's watchdog allows, far longer than a dispatch's overhead
MIN_ROWS = 8  # of a dispatch
MAX_FIRST_PIXELS = 1 << 20  # of a first dispatch, before anything is measured
SAMPLE_BLOCK = 8  # pixels on a side of a block of adaptive sampling, whose halves have a number of samples each
MAX_ROWS = 1 << 18  # of a dispatch: devices take 65,535 workgroups of 8 rows
SQUARE = 8  # pixels on a side of a workgroup
MAX_SAMPLES = 64  # per pixel in one dispatch
MAX_PATHS = 1 << 20  # of a dispatch; a GPU runs some 200,000 threads at once
MAX_CPU_PATHS = 1 << 16
MAX_WAVES = 32  # before the paths that are left are traced to their ends by one pass
STORED_QUADS = 13  # of four numbers, of each path
STORED_BYTES = 16 * STORED_QUADS
INDEPENDENT_SAMPLES = "#define INDEPENDENT_SAMPLES"  # the header of shaders without low-discrepancy sequences
LIGHT_STRATEGIES = ("mis", "nee", "brdf")
"""mis: multiple importance sampling of light samples and BRDF samples. nee: next event estimation, light samples alone.
brdf: BRDF samples alone. All have the same mean."""
_SEED_STEP = 0x9E3779B9  # odd, so that the seeds of 2^32 pictures differ
PIXEL_FILTERS = {"box": 0.5, "gaussian": 2.0, "blackman_harris": 1.5}
"""The radius of each filter in pixels. The Gaussian's standard deviation is a quarter of its radius."""


@dataclass(frozen=True)
class Settings:
    """The options that `PathTracer` documents. Raises SolariError for values out of range."""

    max_bounces: int
    seed: int
    light_strategy: str
    pixel_filter: str
    layering: str
    lambert: bool
    first_sample: int

    def __post_init__(self) -> None:
        choices = {"light_strategy": LIGHT_STRATEGIES, "layering": LAYERINGS, "pixel_filter": tuple(PIXEL_FILTERS)}
        for name, known in choices.items():
            value = getattr(self, name)
            if not is_name(value, known):
                raise SolariError(f"PathTracer: {name} must be one of {', '.join(known)}, not {quoted(value)}")
        for name in ("max_bounces", "seed", "first_sample"):
            value = getattr(self, name)
            if not isinstance(value, Integral):
                raise SolariError(f"PathTracer: {name} must be a whole number, not {quoted(value)}")
            number = int(value)  # numpy's would wrap around
            if not 0 <= number < 2**32:
                raise SolariError(f"PathTracer: {name} must lie between 0 and 2^32 - 1, not {quoted(value)}")
            object.__setattr__(self, name, number)


def trace_stage(
    size: tuple[int, int], rows: int, max_paths: int, settings: Settings, starts_at_points: bool = False
) -> Stage:
    """The means of all pixels, and a dispatch over some rows, from the uniform first_row on.

    max_paths: the paths of at most `samples_at_once` samples are traced together, wave by wave. starts_at_points: the
    path of each pixel starts at its point of the buffer `measured_points` instead of the camera; samples are
    independent. The host may write `sample_ranges`. Inputs: `*_table`, `brdf_averages`. Outputs: `radiance_mean`,
    `luminance_deviations`, `ray_count`.
    """
    pixels = size[0] * size[1]
    paths = _paths_of_a_sample(size[0], rows) * samples_at_once(size[0], rows, max_paths)
    buffers: dict[str, int | IfUsed] = {
        # Means and sums of squared deviations, updated as by Welford (1962), take any number of samples in float32.
        **dict.fromkeys(("radiance_mean", "luminance_deviations", "ray_count"), pixels),
        # The difference of a block's halves tells its error.
        "sample_ranges": IfUsed(2 * math.prod(math.ceil(side / SAMPLE_BLOCK) for side in size)),
        "stored_paths": STORED_QUADS * paths,
        "wave_queues": 2 * paths,  # the paths of this wave and of the next one
        "wave": 1,
    }
    waves = min(settings.max_bounces + 1, MAX_WAVES)
    brdf = brdf_constants(settings)
    start = "illuminance" if starts_at_points else "start"
    passes = [
        Pass("reference/next_wave", threads=1, constants={"begins_dispatch": True}),
        Pass(f"reference/{start}", threads=thread_rows(paths)),
    ]
    next_wave = Pass("reference/next_wave", threads=1)
    for _ in range(waves):
        passes += [
            next_wave,
            Pass("reference/trace_wave", indirect="wave"),
            Pass("reference/shade_wave", indirect="wave", constants=brdf),
        ]
    if settings.max_bounces >= MAX_WAVES:
        passes += [next_wave, Pass("reference/finish", indirect="wave", constants=brdf)]
    passes.append(Pass("reference/accumulate", threads=(size[0], rows)))
    if starts_at_points:
        passes = [replace(one, header=INDEPENDENT_SAMPLES) for one in passes]
    return Stage("reference", buffers=buffers, passes=passes)


def max_paths(kind: str, buffer_bytes: int) -> int:
    """How many paths are traced at a time. kind: of the device, such as "cpu". buffer_bytes: of its largest buffer."""
    return min(MAX_CPU_PATHS if kind == "cpu" else MAX_PATHS, buffer_bytes // STORED_BYTES)


def max_width(buffer_bytes: int) -> int:
    """The most pixels of a row, all of which a dispatch takes. buffer_bytes: of the device's largest buffer."""
    return buffer_bytes // STORED_BYTES // SQUARE * SQUARE


def samples_at_once(width: int, rows: int, max_paths: int) -> int:
    """The most samples of each pixel that a dispatch over so many rows takes."""
    return max(min(max_paths // _paths_of_a_sample(width, rows), MAX_SAMPLES), 1)


def _paths_of_a_sample(width: int, rows: int) -> int:
    """The paths of one sample of each pixel, in whole squares of pixels: glsl/passes/reference/path_index.glsl."""
    height = min(SQUARE, rows)
    return math.ceil(width / SQUARE) * SQUARE * math.ceil(rows / height) * height


def aov_stage(size: tuple[int, int], rows: int, shader: str = "aov", has_motion: bool = False) -> Stage:
    """The surface at the center of every pixel, by a ray or, with the shader "raster_aov", of the triangle that raster
    has found. has_motion: its motion instead, since the frame that `previous_instances` and `previous_camera` are of.

    Inputs: with "raster_aov" `raster_triangles`, `depth`. Outputs: `aov_*`.
    """
    pixels = size[0] * size[1]
    buffers = {f"aov_{name}": 1 if has_motion else pixels for name in FIRST_HITS}
    buffers["aov_motion_vectors"] = pixels if has_motion else 1
    if not has_motion:
        buffers["previous_instances"] = 1  # which the shader names, and doesn't read
    constants = {"has_motion": has_motion}
    return Stage(
        "aov", buffers=buffers, passes=[Pass(f"reference/{shader}", threads=(size[0], rows), constants=constants)]
    )


def write_uniforms(uniforms: Uniforms, settings: Settings) -> None:
    """Write the settings; camera and rows are the renderer's to write."""
    uniforms["path_sampling.seed"] = settings.seed
    uniforms["path_sampling.first_sample"] = settings.first_sample
    uniforms["path_sampling.max_bounces"] = settings.max_bounces
    uniforms["path_sampling.light_strategy"] = LIGHT_STRATEGIES.index(settings.light_strategy)
    uniforms["path_sampling.pixel_filter"] = list(PIXEL_FILTERS).index(settings.pixel_filter)
    uniforms["path_sampling.filter_radius"] = PIXEL_FILTERS[settings.pixel_filter]


def rows_of(size: tuple[int, int], pixels: int) -> int:
    """Rows of a picture in one dispatch over so many pixels at most, but at least one row."""
    return min(size[1], max(pixels // size[0], 1), MAX_ROWS)


def max_rows(size: tuple[int, int], pixel_ms: float = 0.0, max_paths: int = MAX_FIRST_PIXELS) -> int:
    """Rows of a picture in one dispatch before anything is measured: few enough for any driver's watchdog.

    pixel_ms: the milliseconds of a sample of a pixel in another picture, if known; the dispatch then takes DISPATCH_MS.
    """
    most = max_paths // _paths_of_a_sample(size[0], 1)
    most = most // SQUARE * SQUARE or most  # whole squares, where there is room for one
    rows = min(rows_of(size, MAX_FIRST_PIXELS), max(most, 1))
    if pixel_ms == 0.0:
        return rows
    return min(rows, max(int(DISPATCH_MS / (pixel_ms * size[0])), MIN_ROWS))


def read_mean(frame: Frame, size: tuple[int, int]) -> NDArray[np.float32]:
    """Radiance (height, width, 3)."""
    return frame["radiance_mean"].reshape(size[1], size[0], 3)


def read_variance(frame: Frame, samples: NDArray[np.int64]) -> NDArray[np.float32]:
    """Variance of the mean luminance (height, width) as if samples were independent; inf after a single sample.

    They are points of low-discrepancy sequences, so the mean's own variance is smaller. samples (height, width): the
    number of each pixel.
    """
    deviations = frame["luminance_deviations"].reshape(samples.shape)
    count = samples.astype(np.float64)
    variance = np.full(samples.shape, np.inf)
    # The samples' own variance is the sum of squared deviations over count - 1, and that of their mean 1 / count of it.
    np.divide(deviations, count * (count - 1), out=variance, where=samples > 1)
    return variance.astype(np.float32)


def read_aov(frame: Frame, name: str, size: tuple[int, int]) -> NDArray[Any]:
    """One of FIRST_HITS, (height, width[, channels])."""
    values = frame[f"aov_{name}"]
    return values.reshape(size[1], size[0], *values.shape[1:])


def glsl_header() -> str:
    """`const uint LIGHT_STRATEGY_MIS = 0u;`, `const uint PIXEL_FILTER_BOX = 0u;` and so on, and STORED_QUADS."""
    names = {"LIGHT_STRATEGY": LIGHT_STRATEGIES, "PIXEL_FILTER": PIXEL_FILTERS}
    return "\n".join([*(enumeration(*item) for item in names.items()), constants(STORED_QUADS=STORED_QUADS)])


def numbered_seed(seed: int, number: int) -> int:
    """The seed of one of many pictures with independent noise; picture 0 has `seed` itself."""
    # With a step of 1, sets of pictures with the seeds 1 and 2 would share all pictures but one.
    return (seed + number * _SEED_STEP) % 2**32


def numbered_seeds(seed: int, count: int) -> NDArray[np.uint32]:
    """`numbered_seed` of the pictures from 0 to count - 1."""
    return (seed + np.arange(count, dtype=np.uint64) * _SEED_STEP).astype(np.uint32)
