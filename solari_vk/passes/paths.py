"""One path a pixel, more where it has little history: all light of a surface; glsl/passes/paths/."""

from __future__ import annotations

import itertools

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.gpu.shaders.headers import constants
from solari_vk.passes.rows import GROUP_SIZE
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

RESERVOIRS = ("paths_temporal_reservoirs", "paths_reservoirs")
SCRATCH = {"sample_radiance": "paths_states", "error": "paths_ray_queues"}
"""Results of later stages that alias buffers of this one, since all paths are traced by then."""
MIN_TIMED_SAMPLES = 2  # the least maximum of paths of a pixel with frame_ms
SHORT_HISTORY = 8.0  # frames of history from which one path is enough
WAVES = 3  # dispatches over the paths that go on after their first rays; the last one traces them to their ends


def stage(size: tuple[int, int], settings: Settings, views: int) -> Stage:
    """The light of the diffuse and of the specular lobe, demodulated, each with a distance in meters.

    Inputs: `gbuffer*`, `depth`, `*_table`, `brdf_averages`, `world_cache_*`; the length of the history,
    `denoise_guides` and `denoise_diffuse`; with restir `motion_vectors`, `previous_*`.
    Outputs: `paths_diffuse`, `paths_specular`, and new cells, `world_cache_*`.
    """
    pixels, brdf = size[0] * size[1], brdf_constants(settings)
    short = 1 if settings.restir else settings.paths_short_history_samples
    timed = settings.frame_ms > 0
    samples = most_timed_samples(short) if timed else short
    sample_counts = {"short_history_samples": short, "max_timed_samples": samples if timed else 0}
    traced = brdf | sample_counts | {"paths_reuse": settings.restir}
    of_list = Pass("paths/first_ray", indirect="paths_wave", constants=traced)  # over a list of pixels
    first = of_list if timed else Pass("paths/first_ray", threads=size, constants=traced)
    later = Pass("paths/later_rays", indirect="paths_wave", constants=traced)
    chosen = {"pixels_are_chosen": timed}
    passes = [
        part
        for sample, index in itertools.product(range(samples), range(WAVES + 1))
        for part in (
            Pass(
                "paths/next_wave", threads=GROUP_SIZE, constants=chosen | {"sample_index": sample, "wave_index": index}
            ),
            later if index else of_list if sample else first,
        )
    ]
    choose = [Pass("paths/choose_pixels", threads=size, constants=sample_counts)]
    reuse = [Pass(f"paths/{name}", threads=size, constants=brdf) for name in ("temporal", "spatial_and_shade")]
    return Stage(
        "paths",
        buffers={
            **dict.fromkeys(("paths_diffuse", "paths_specular", "paths_states"), pixels),
            "paths_ray_queues": 2 * pixels,
            "paths_queues": views,
            "paths_wave": 1,
            "paths_short_histories": pixels if samples > 1 else 1,
            "paths_chosen": pixels if timed else 1,
            "paths_reservoir_candidates": pixels if settings.restir else 1,
            **(dict.fromkeys(RESERVOIRS, pixels) if settings.restir else {}),
        },
        passes=[*choose[:timed], *passes, *reuse[: 2 * settings.restir]],
    )


def most_timed_samples(short_history_samples: int) -> int:
    """The most paths that a pixel takes with frame_ms."""
    return max(short_history_samples, MIN_TIMED_SAMPLES)


def glsl_header() -> str:
    """The index of the last wave; frames of history from which one path is enough."""
    return constants(LAST_WAVE=WAVES, SHORT_HISTORY=SHORT_HISTORY)
