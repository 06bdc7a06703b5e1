"""The picture: what all passes found added up; glsl/passes/display/."""

from __future__ import annotations

from solari_vk.gpu.frame import Pass, Stage
from solari_vk.settings import Settings


RAY_COUNTERS = 8  # RAYS_OF_* of passes/ray_count.glsl


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """Radiance before exposure, in parts and as a whole."""
    pixels = size[0] * size[1]
    return Stage(
        "display",
        buffers={name: pixels for name in ("emission", "diffuse_radiance", "specular_radiance", "radiance")} | {"ray_counts": RAY_COUNTERS},
        passes=[Pass("display/compose", threads=size)],
    )
