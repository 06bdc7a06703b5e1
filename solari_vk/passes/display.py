"""The picture: `compose` adds the light of all passes, `show` turns it into 8-bit colors; glsl/passes/display/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage

RAY_COUNTERS = 16  # rows for passes that count their rays: passes/ray_count.glsl
PARTS = ("emission", "diffuse_radiance", "specular_radiance", "sample_radiance")


def compose_stage(size: tuple[int, int]) -> Stage:
    """Linear radiance in cd/m^2: emission, the diffuse lobe and the specular lobe, and their sum."""
    pixels = size[0] * size[1]
    return Stage(
        "compose",
        buffers=dict.fromkeys(PARTS, pixels) | {"ray_counts": RAY_COUNTERS},
        passes=[Pass("display/compose", threads=size)],
    )


def show_stage(size: tuple[int, int], lighting: str = "") -> Stage:
    """`display`, 8-bit sRGB: `radiance` after exposure and tone mapping, or a debug view of this lighting.

    Without a lighting there are no debug views, and the stage needs nothing but `radiance`.
    """
    passes = ["display/show"] + ([f"display/debug_view_{lighting}"] if lighting else [])
    return Stage("show", images={"display": size}, passes=[Pass(name, threads=size) for name in passes])
