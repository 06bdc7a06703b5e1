"""One path a pixel: all light of a surface; glsl/passes/paths/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.passes.display import PARTS, RAY_COUNTERS
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The light of the diffuse and of the specular lobe, demodulated, each with a distance in meters."""
    pixels = size[0] * size[1]
    return Stage(
        "paths",
        buffers={"paths_diffuse": pixels, "paths_specular": pixels},
        passes=[Pass("paths/trace", threads=size, constants=brdf_constants(settings))],
    )


def compose_stage(size: tuple[int, int], settings: Settings) -> Stage:
    """Linear radiance in cd/m^2: emission, the diffuse lobe and the specular lobe, and their sum."""
    return Stage(
        "compose",
        buffers=dict.fromkeys(PARTS, size[0] * size[1]) | {"ray_counts": RAY_COUNTERS},
        passes=[Pass("paths/compose", threads=size, constants=brdf_constants(settings))],
    )
