"""Specular GI: mirror and glossy reflections; glsl/passes/specular_gi/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The radiance specular_gi: light by the specular lobe that DI doesn't shade."""
    brdf = brdf_constants(settings)
    return Stage(
        "specular_gi",
        buffers={"specular_gi": size[0] * size[1]},
        passes=[Pass("specular_gi/trace", threads=size, constants=brdf)],
    )
