"""Specular GI: what surfaces mirror, sharply or blurred; glsl/passes/specular_gi/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """`specular_gi`: radiance over the specular lobe that DI hasn't found."""
    brdf = brdf_constants(settings)
    return Stage(
        "specular_gi",
        buffers={"specular_gi": size[0] * size[1]},
        passes=[Pass("specular_gi/trace", threads=size, constants=brdf)],
    )
