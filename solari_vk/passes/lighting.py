"""The stages that compute light, for each value of the setting `lighting`."""

from __future__ import annotations

import math

from solari_vk.gpu.frame.stages import Stage
from solari_vk.passes import denoise, display, paths, solari019, world_cache
from solari_vk.settings import FIELDS, Settings


def stages(size: tuple[int, int], settings: Settings, grid: tuple[int, int] = (1, 1), worlds: int = 1) -> list[Stage]:
    """The stages that compute and denoise the light of a frame, in order; the last one adds it up. grid: columns and
    rows of views, which show so many worlds."""
    if settings.lighting == "split":
        light, scratch = solari019.stages(size, settings), {}
    else:
        cache = world_cache.paths_stage(size, settings, worlds)
        light, scratch = [cache, paths.stage(size, settings, math.prod(grid))], paths.SCRATCH
    return [
        denoise.history_stage(size),
        *light,
        denoise.stage(size, grid, settings.frame_ms > 0),
        display.compose_stage(size, settings, scratch),
    ]


def debug_view_pass(lighting: str) -> str:
    """The pass that draws the debug views of a lighting."""
    return "solari019/debug_view" if lighting == "split" else "display/debug_view"


def lighting_with(resource: str) -> str:
    """The value of the setting `lighting` whose stages have a buffer or image of this name; empty if none has."""
    for name in FIELDS["lighting"].choices:
        found = stages((1, 1), Settings(lighting=name))
        if any(resource in (*stage.buffers, *stage.images) for stage in found):
            return name
    return ""
