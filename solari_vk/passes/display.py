"""The sum of all light, and the picture in 8-bit colors; glsl/passes/display/."""

from __future__ import annotations

from collections.abc import Mapping

from solari_vk.gpu.frame.stages import Aliased, Pass, Stage
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

RAY_COUNTERS = 16  # rows for passes that count their rays: passes/ray_count.glsl
PARTS = ("emission", "diffuse_radiance", "specular_radiance", "sample_radiance")


def compose_stage(size: tuple[int, int], settings: Settings, scratch: Mapping[str, str]) -> Stage:
    """Linear radiance in cd/m^2: emission, the diffuse lobe and the specular lobe, their sum, and that without the
    denoiser, `raw_radiance`. scratch: for some of these the buffer whose memory they take.

    Inputs: `paths_diffuse`, `paths_specular`, `denoise_pong`, `denoise_guides`, `denoise_diffuse`, `denoise_specular`,
    `gbuffer*`, `depth`, `guides_*_albedo`, `brdf_table`, `brdf_averages`, `sheen_table`, `glass_table`.
    Outputs: `*_radiance`, `emission`, `error`.
    """
    pixels = size[0] * size[1]
    return Stage(
        "compose",
        buffers={
            **dict.fromkeys((*PARTS, "raw_radiance", "error"), pixels),
            **{name: Aliased(buffer, pixels) for name, buffer in scratch.items()},
            "ray_counts": RAY_COUNTERS,
        },
        passes=[Pass("display/compose", threads=size, constants=brdf_constants(settings))],
    )


def show_stage(size: tuple[int, int], debug_view: str = "") -> Stage:
    """`display`, 8-bit sRGB: `radiance` after exposure and tone mapping, or what the pass `debug_view` draws.

    Inputs: `radiance`, and for debug views what they show: `*`. Outputs: `display`.
    """
    passes = ["display/show"] + [debug_view] * bool(debug_view)
    return Stage("show", images={"display": size}, passes=[Pass(name, threads=size) for name in passes])
