"""Guide images for denoisers; glsl/passes/guides/.

For each pixel: `guides_diffuse_albedo` and `guides_specular_albedo` (rgb; the latter is the environment BRDF),
`guides_normal_roughness` (world-space shading normal, perceptual roughness), `guides_depth` (near / distance along the
view axis, 0 without a surface), `guides_motion` and `guides_specular_motion` (uv in the previous frame minus uv,
without jitter).

With primary surface replacement, a pixel that shows a smooth metal describes the first surface in the chain of mirrors
that is no mirror, at its virtual position: normal, depth and specular motion are those of the virtual surface. A thin
wall of smooth glass that shows more than it reflects is passed by this chain, and describes itself where a light or
nothing is behind it.
`guides_motion` remains the motion of the mirror itself. A denoiser that takes a single motion uses
`guides_specular_motion`, which agrees with the depth in every pixel. Virtual positions are exact for flat mirrors; a
curved mirror is replaced by its tangent plane. The alpha of `guides_specular_albedo` is 0 in these pixels, else 1; that
of `guides_diffuse_albedo` is 0 where they show a light or nothing.
"""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings

IMAGES = ("diffuse_albedo", "specular_albedo", "normal_roughness", "depth", "motion", "specular_motion")


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The images, computed from the G-buffer, and from rays where a pixel shows a mirror.

    Inputs: `gbuffer*`, `depth`, `motion_vectors`, `previous_instances`, `*_table`,
    `brdf_averages`. Outputs: `guides_*`.
    """
    # One pass writes all images, since the chain of mirrors that they describe is traced once.
    return Stage(
        "guides",
        images={f"guides_{name}": size for name in IMAGES},
        passes=[Pass("guides/write", threads=size, constants={"lambertian_surfaces": settings.lambert})],
    )
