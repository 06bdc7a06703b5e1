"""ReSTIR DI: the light that surfaces reflect straight from lights; glsl/passes/restir_di/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The reservoirs after each half, and the radiance by the diffuse and the specular lobe."""
    pixels = size[0] * size[1]
    brdf = brdf_constants(settings)
    initial = "visible_initial_and_temporal" if settings.di_initial_visibility else "initial_and_temporal"
    return Stage(
        "restir_di",
        buffers={
            "di_reservoirs": pixels,
            "di_temporal_reservoirs": pixels,
            "di_outcomes": pixels,
            "di_diffuse": pixels,
            "di_specular": pixels,
        },
        passes=[
            Pass(f"restir_di/{initial}", threads=size, constants={"brdf_lambert": settings.lambert}),
            Pass("restir_di/spatial_and_shade", threads=size, constants=brdf),
        ],
    )
