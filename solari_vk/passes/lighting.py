"""The stages of each lighting, as the setting `lighting` names it."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Stage
from solari_vk.passes import denoise, display, light_tiles, paths, restir_di, restir_gi, specular_gi, world_cache
from solari_vk.settings import FIELDS, Settings


def stages(size: tuple[int, int], settings: Settings) -> list[Stage]:
    """The stages that compute the light of a frame, in order; the last one adds it up."""
    if settings.lighting == "paths":
        return [
            world_cache.stage(size, settings),
            denoise.history_stage(size),
            paths.stage(size, settings),
            denoise.stage(size),
            paths.compose_stage(size, settings),
        ]
    return [
        light_tiles.stage(settings),
        world_cache.stage(size, settings),
        restir_di.stage(size, settings),
        restir_gi.stage(size, settings),
        specular_gi.stage(size, settings),
        display.compose_stage(size),
    ]


def that_has(resource: str) -> str:
    """The name of the lighting whose stages have a resource; empty if none has."""
    for name in FIELDS["lighting"].choices:
        found = stages((1, 1), Settings(lighting=name))
        if any(resource in (*stage.buffers, *stage.images) for stage in found):
            return name
    return ""
