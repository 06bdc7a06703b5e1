"""One path a pixel, more where it has little history: all light of a surface; glsl/passes/paths/."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from solari_vk.gpu.frame.stages import Counter, IfUsed, Pass, Stage
from solari_vk.gpu.shaders.headers import constants
from solari_vk.passes.rows import GROUP_SIZE
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

if TYPE_CHECKING:  # shaders are compiled with this module's header on machines without Vulkan
    from solari_vk.gpu.device.physical import DeviceProperties

Constants = dict[str, Any]  # values of specialization constants, by name

RESERVOIRS = ("paths_temporal_reservoirs", "paths_reservoirs")
SCRATCH = {"sample_radiance": "paths_states", "error": "paths_ray_queues"}
"""Results of later stages that alias buffers of this one, since all paths are traced by then."""
MIN_TIMED_SAMPLES = 2  # with frame_ms a pixel may take this many paths, whatever the settings say
SHORT_HISTORY = 8.0  # paths of a pixel's history from which one path is enough
STATE_QUADS, RAYS_QUADS, HIT_QUADS = 6, 7, 5
"""Of a path, its rays and what they have hit: four numbers each, as glsl/passes/paths/pack_path.glsl packs them."""
WAVES_APART = 6  # with traces_apart, the waves before the last one, that of first rays among them
FEW_PATHS = 1 << 14  # fewer don't go through waves that are traced apart
WAVES = 3  # dispatches over the paths that go on after their first rays; the last one traces them to their ends


def stage(size: tuple[int, int], settings: Settings, views: int, traces_apart: bool = False) -> Stage:
    """The light of the diffuse and of the specular lobe, demodulated, each with a distance in meters.

    traces_apart: whether a pass that only traces has the rays of each wave; see `apart_bytes`.

    Inputs: `camera_media`, `gbuffer*`, `depth`, `*_table`, `brdf_averages`, `world_cache_*`; the length of the history,
    `denoise_guides` and `denoise_diffuse`; with restir `motion_vectors`, `previous_*`.
    Outputs: `paths_diffuse`, `paths_specular`, and new cells, `world_cache_*`.
    """
    pixels = size[0] * size[1]
    has_frame_ms = settings.frame_ms > 0
    chooses_pixels = has_frame_ms or is_sparse(settings)
    # ReSTIR's reservoirs hold one path of a pixel.
    short_history_samples = 1 if settings.restir else settings.paths_short_history_samples
    max_samples = most_timed_samples(short_history_samples) if has_frame_ms else short_history_samples
    sample_counts = {
        "short_history_samples": short_history_samples,
        "max_timed_samples": max_samples if has_frame_ms else 0,
        "pixels_per_path": pixels_per_path(settings),
    }
    brdf = brdf_constants(settings)
    passes: list[Pass] = []
    if chooses_pixels:
        passes.append(Pass("paths/choose_pixels", threads=size, constants=sample_counts))
    for sample in range(max_samples):
        passes += _waves(size, sample, traces_apart, brdf | {"paths_reuse": settings.restir}, sample_counts)
    buffers: dict[str, int | Counter] = {
        **dict.fromkeys(("paths_diffuse", "paths_specular"), pixels),
        "paths_states": STATE_QUADS * pixels,
        "paths_ray_queues": 2 * pixels,  # the paths that go on, of this wave and of the next
        "paths_queues": views,
        "paths_wave": 1,
        # Lists of pixels. Shaders that don't read them declare them all the same, so they have one element then.
        "paths_short_histories": pixels if max_samples > 1 else 1,
        "paths_chosen": Counter(pixels if chooses_pixels else 1),
        "paths_reservoir_candidates": pixels if settings.restir else 1,
        "paths_rays": RAYS_QUADS * pixels if traces_apart else 1,
    }
    if traces_apart:
        buffers["paths_hits"] = HIT_QUADS * pixels
    if settings.restir:
        # Reuse between frames, then between neighbors: Lin et al., "Generalized Resampled Importance Sampling" (2022).
        buffers |= dict.fromkeys(RESERVOIRS, pixels)
        passes.append(Pass("paths/temporal", threads=size, constants=brdf))
        passes.append(Pass("paths/spatial_and_shade", threads=size, constants=brdf))
    return Stage("paths", buffers=buffers, passes=passes)


def is_sparse(settings: Settings) -> bool:
    """Whether with `upscale` all pixels of the picture are there, and some take no path in a frame: the denoiser fills
    them. Else fewer pixels are rendered."""
    follows = settings.denoise and settings.lighting == "paths" and not settings.restir and settings.frame_ms == 0
    return follows and settings.upscale > 1


def pixels_per_path(settings: Settings) -> float:
    """The number of pixels of which one takes a path in a frame."""
    return settings.upscale**2 if is_sparse(settings) else 1.0


def block_width(settings: Settings) -> int:
    """The width in pixels of blocks that take their paths in the same order."""
    return math.ceil(settings.upscale) if is_sparse(settings) else 1


def apart_bytes(rays: str, device: DeviceProperties) -> int:
    """If a pass that does nothing else traces the rays of paths: the bytes that a buffer may have; else 0.

    A GPU runs the fewer threads at a time the more registers a shader needs, and one that shades needs many.
    """
    if rays != "compute" or device.kind == "cpu":
        return 0
    return int(device.limits.maxStorageBufferRange)


def medium_stage(views: int, has_absorption: bool) -> Stage:
    """The solids in which the views' cameras are, such as water. has_absorption: whether solids of the scene absorb
    light; else no pass looks for them.

    Outputs: `camera_media`.
    """
    passes = [Pass("camera_medium", threads=(views, 1))] if has_absorption else []
    # Shaders with other features declare the buffer all the same.
    return Stage("camera_medium", buffers={"camera_media": IfUsed(views)}, passes=passes)


def _waves(
    size: tuple[int, int], sample: int, traces_apart: bool, shading: Constants, sample_counts: Constants
) -> list[Pass]:
    """The passes over one path of each pixel, or of each that takes so many: first rays, then those of the rest.

    Few paths are long. A pass that traced whole paths would keep the threads of the others waiting (Laine, Karras and
    Aila, "Megakernels Considered Harmful", 2013), so each wave is a dispatch over the list of the paths that are left.
    """
    passes = []
    chosen = {name: sample_counts[name] for name in ("max_timed_samples", "pixels_per_path")}
    chooses_pixels = chosen["max_timed_samples"] > 0 or chosen["pixels_per_path"] > 1
    constants = shading | sample_counts
    waves = max(WAVES_APART, WAVES) if traces_apart else WAVES  # later_rays traces on from LAST_WAVE
    for wave in range(waves + 1):
        begin = {"pixels_are_chosen": chooses_pixels, "sample_index": sample, "wave_index": wave}
        begin |= {"few_paths": FEW_PATHS if traces_apart and 0 < wave < waves else 0, "is_last_wave": wave == waves}
        passes.append(Pass("paths/next_wave", threads=GROUP_SIZE, constants=begin))
        all_pixels = wave == 0 and sample == 0 and not chooses_pixels  # take a first path
        over: dict[str, Any] = {"threads": size} if all_pixels else {"indirect": "paths_wave"}
        if wave == 0:
            passes.append(Pass("paths/first_ray", constants=constants | {"traces_apart": traces_apart}, **over))
        elif wave == waves or not traces_apart:
            passes.append(Pass("paths/later_rays", constants=constants, **over))
        else:
            passes.append(Pass("paths/choose", constants=shading | chosen, **over))
        if traces_apart and wave < waves:
            passes.append(Pass("paths/trace", constants=chosen, **over))
            passes.append(Pass("paths/arrive", constants=constants, **over))
    return passes


def most_timed_samples(short_history_samples: int) -> int:
    """The most paths that a pixel takes with frame_ms."""
    return max(short_history_samples, MIN_TIMED_SAMPLES)


def glsl_header() -> str:
    """The least index of the last wave, frames of history from which one path is enough, and the numbers of quads."""
    quads = {"STATE_QUADS": STATE_QUADS, "RAYS_QUADS": RAYS_QUADS, "HIT_QUADS": HIT_QUADS}
    return constants(LAST_WAVE=WAVES, SHORT_HISTORY=SHORT_HISTORY, **quads)
