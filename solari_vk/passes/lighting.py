"""The stages that compute light, for each value of the setting `lighting`."""

from __future__ import annotations

import math
from collections.abc import Mapping

from solari_vk.gpu.frame.stages import Stage
from solari_vk.passes import denoise, display, paths, solari019, world_cache
from solari_vk.settings import FIELDS, Settings


def stages(
    size: tuple[int, int],
    settings: Settings,
    grid: tuple[int, int] = (1, 1),
    worlds: int = 1,
    has_absorption: bool = False,
    apart_bytes: int = 0,
) -> list[Stage]:
    """The stages that compute and denoise the light of a frame, in order, and add it up. grid: columns and rows
    of views, which show so many worlds. has_absorption: whether solids in them absorb light.
    apart_bytes: what `paths.apart_bytes` has returned."""
    scratch: Mapping[str, str] = {}
    skips_pixels = settings.frame_ms > 0 or paths.is_sparse(settings)
    views = math.prod(grid)
    if settings.lighting == "split":
        light = solari019.stages(size, settings)
    else:
        cache = world_cache.paths_stage(size, settings, worlds, apart_bytes)
        light = [cache, paths.stage(size, settings, views, traces_apart=apart_bytes > 0)]
        scratch = paths.SCRATCH
    return [
        paths.medium_stage(views, has_absorption),
        # Before the light, because pixels with a short history take more paths.
        denoise.history_stage(size, skips_pixels),
        *light,
        denoise.stage(size, grid, skips_pixels, paths.block_width(settings)),
        display.compose_stage(size, settings, scratch),
        denoise.reflections_stage(size),
    ]


def debug_view_pass(lighting: str) -> str:
    """The pass that draws the debug views of a lighting."""
    return "solari019/debug_view" if lighting == "split" else "display/debug_view"


def lighting_with(resource: str) -> str:
    """The value of the setting `lighting` whose stages have a buffer or image of this name; empty if none has."""
    for name in FIELDS["lighting"].choices:
        # The smallest picture will do: the names don't depend on the size.
        found = stages((1, 1), Settings(lighting=name))
        if any(resource in (*stage.buffers, *stage.images) for stage in found):
            return name
    return ""
