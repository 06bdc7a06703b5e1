"""Guide buffers, for denoisers; glsl/passes/guides/.

Of what each pixel shows: `guides_diffuse_albedo` and `guides_specular_albedo` (rgb; the latter the environment BRDF),
`guides_normal_roughness` (world-space shading normal, perceptual roughness), `guides_depth` (near / distance along the
view axis, 0: nothing), `guides_motion` and `guides_specular_motion` (uv of the last frame minus uv, without jitter).

With primary surface replacement a pixel of a smooth metal describes the first surface in its chain of mirrors that is
none, as if it stood where it seems to: normal, depth and specular motion are the virtual ones. `guides_motion` stays
the mirror's own; a denoiser with one motion takes `guides_specular_motion`, which goes with the depth in every pixel.
Exact for flat mirrors; curved ones count as their tangent plane.
"""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.settings import Settings

IMAGES = ("diffuse_albedo", "specular_albedo", "normal_roughness", "depth", "motion", "specular_motion")


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """The images, written from the G-buffer and, behind mirrors, from rays."""
    return Stage(
        "guides",
        images={f"guides_{name}": size for name in IMAGES},
        passes=[Pass("guides/write", threads=size, constants={"brdf_lambert": settings.lambert})],
    )
