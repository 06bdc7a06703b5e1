"""The stages of each lighting, as the setting `lighting` names it."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Stage
from solari_vk.passes import denoise, paths, solari019, world_cache
from solari_vk.settings import FIELDS, Settings


def stages(size: tuple[int, int], settings: Settings) -> list[Stage]:
    """The stages that compute the light of a frame, in order; the last one adds it up."""
    if settings.lighting == "split":
        return solari019.stages(size, settings)
    return [
        world_cache.paths_stage(size, settings),
        denoise.history_stage(size),
        paths.stage(size, settings),
        denoise.stage(size),
        paths.compose_stage(size, settings),
    ]


def debug_view_pass(lighting: str) -> str:
    """The pass that draws the debug views of a lighting."""
    return "solari019/debug_view" if lighting == "split" else "display/debug_view"


def that_has(resource: str) -> str:
    """The name of the lighting whose stages have a resource; empty if none has."""
    for name in FIELDS["lighting"].choices:
        found = stages((1, 1), Settings(lighting=name))
        if any(resource in (*stage.buffers, *stage.images) for stage in found):
            return name
    return ""
