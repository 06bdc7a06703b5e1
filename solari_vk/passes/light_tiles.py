"""Light tiles: light samples drawn ahead for all passes that choose among them; glsl/passes/light_tiles/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings


def stage(settings: Settings) -> Stage:
    """All tiles, one after the other: their samples, and these resolved and packed."""
    count = settings.light_tile_count * settings.light_tile_samples
    constants = {"samples_each": settings.light_tile_samples}
    return Stage(
        "light_tiles",
        buffers={"light_tile_samples": count, "light_tiles": count},
        passes=[Pass("light_tiles/generate", threads=count, constants=constants)],
    )
