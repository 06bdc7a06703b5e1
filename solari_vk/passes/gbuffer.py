"""The G-buffer: what every pixel shows, and where that was in the last frame; glsl/passes/gbuffer/."""

from __future__ import annotations

from solari_vk.gpu.frame import History, Pass, Stage
from solari_vk.settings import Settings


def stage(size: tuple[int, int], settings: Settings, instance_capacity: int) -> Stage:
    """The images of the packed layout with their history. instance_capacity: rows of the scene's `instances`."""
    return Stage(
        "gbuffer",
        buffers={"previous_instances": instance_capacity},
        images={
            "gbuffer": History(size),
            "gbuffer_surface": History(size),
            "depth": History(size),
            "motion_vectors": size,
        },
        passes=[
            Pass("gbuffer/trace", threads=size),
            Pass("gbuffer/remember_instances", threads=instance_capacity),
        ],
    )
