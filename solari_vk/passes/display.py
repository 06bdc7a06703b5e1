"""The picture in 8-bit colors; glsl/passes/display/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage

RAY_COUNTERS = 16  # rows for passes that count their rays: passes/ray_count.glsl
PARTS = ("emission", "diffuse_radiance", "specular_radiance", "sample_radiance")


def show_stage(size: tuple[int, int], debug_view: str = "") -> Stage:
    """`display`, 8-bit sRGB: `radiance` after exposure and tone mapping, or what the pass `debug_view` draws.

    Inputs: `radiance`, and for debug views what they show: `*`. Outputs: `display`.
    """
    passes = ["display/show"] + [debug_view] * bool(debug_view)
    return Stage("show", images={"display": size}, passes=[Pass(name, threads=size) for name in passes])
