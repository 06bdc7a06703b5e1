"""Specular GI: what surfaces mirror, sharply or blurred; glsl/passes/specular_gi/."""

from __future__ import annotations

from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.passes import brdf_table
from solari_vk.settings import Settings


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """`specular_gi`: radiance over the specular lobe that DI hasn't found."""
    brdf = brdf_table.constants(settings)
    return Stage(
        "specular_gi",
        buffers={"specular_gi": size[0] * size[1]},
        passes=[Pass("specular_gi/trace", threads=size, constants=brdf)],
    )
