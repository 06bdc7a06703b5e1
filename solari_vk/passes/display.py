"""The sum of all light, the picture in 8-bit colors, and counters of rays; glsl/passes/{display/,ray_count.glsl}."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from solari_vk.gpu.frame.stages import Aliased, Draw, Pass, Stage, Step
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes.paths import pixels_per_path
from solari_vk.settings import Settings
from solari_vk.settings.layering import brdf_constants

RAY_COUNTERS = 16  # rows for passes that count their rays: passes/ray_count.glsl
PARTS = ("emission", "diffuse_radiance", "specular_radiance", "sample_radiance")


def compose_stage(size: tuple[int, int], settings: Settings, scratch: Mapping[str, str]) -> Stage:
    """Linear radiance in cd/m^2: emission, the diffuse lobe and the specular lobe, their sum, and that without the
    denoiser, `raw_radiance`. scratch: for some of these the buffer whose memory they take.

    Inputs: `camera_media`, `paths_diffuse`, `paths_specular`, `denoise_pong`, `denoise_gains`, `denoise_guides`,
    `denoise_diffuse`, `denoise_specular`, `gbuffer*`, `depth`, `guides_*_albedo`, `brdf_table`, `brdf_averages`,
    `sheen_table`, `glass_table`.
    Outputs: `*_radiance`, `emission`, `error`.
    """
    # Light comes demodulated: divided by the surfaces' colors, so that the denoiser blurs light and not textures.
    pixels = size[0] * size[1]
    constants = brdf_constants(settings) | {"pixels_per_path": pixels_per_path(settings)}
    return Stage(
        "compose",
        buffers={
            **dict.fromkeys((*PARTS, "raw_radiance", "error"), pixels),
            **{name: Aliased(buffer, pixels) for name, buffer in scratch.items()},
            "ray_counts": RAY_COUNTERS,
        },
        passes=[Pass("display/compose", threads=size, constants=constants)],
    )


def show_stage(size: tuple[int, int], debug_view: str = "") -> Stage:
    """`display`, 8-bit sRGB: `radiance` after exposure and tone mapping, or what the pass `debug_view` draws.

    Inputs: `radiance`, and for debug views what they show: `*`. Outputs: `display`.
    """
    passes = ["display/show"]
    if debug_view:
        passes.append(debug_view)
    return Stage("show", images={"display": size}, passes=[Pass(name, threads=size) for name in passes])


def count_rays(stages: Sequence[Stage]) -> tuple[list[Stage], list[str]]:
    """The stages with passes that count their rays in the buffer `ray_counts`; and those passes' names, row by row.

    Passes of one name share a row. A row grows by the number of rays of each frame, modulo 2^32. Counting takes some
    time in each of these passes.
    """
    counted: list[str] = []

    def with_counter(item: Pass | Draw | Step) -> Pass | Draw | Step:
        if not isinstance(item, Pass):
            return item
        # The passes that count are those whose shaders have the constant: they include passes/ray_count.glsl.
        path = f"passes/{item.name}.comp"
        if "ray_counter" not in reflect(compile_shader(path, header=item.header), path).constants:
            return item
        if item.name not in counted:
            counted.append(item.name)
        return dataclasses.replace(item, constants={**item.constants, "ray_counter": counted.index(item.name)})

    found = [dataclasses.replace(stage, passes=[with_counter(item) for item in stage.passes]) for stage in stages]
    return found, counted
