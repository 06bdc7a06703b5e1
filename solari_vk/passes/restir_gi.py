"""ReSTIR GI: indirect light of diffuse surfaces; glsl/passes/restir_gi/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The reservoirs before and after spatial reuse, and the radiance gi_diffuse."""
    pixels = size[0] * size[1]
    brdf = brdf_constants(settings)
    return Stage(
        "restir_gi",
        buffers={"gi_temporal_reservoirs": pixels, "gi_reservoirs": pixels, "gi_diffuse": pixels},
        passes=[
            Pass("restir_gi/initial", threads=size, constants=brdf),
            Pass("restir_gi/temporal", threads=size),
            Pass("restir_gi/spatial_and_shade", threads=size, constants=brdf),
        ],
    )
