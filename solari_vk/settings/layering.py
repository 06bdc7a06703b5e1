"""How the diffuse lobe of a surface lies under its specular lobe, in both renderers."""

from __future__ import annotations

from typing import Protocol

from solari_vk.gpu.shaders.headers import enumeration

LAYERINGS = ("conserving", "fresnel_product")
"""conserving: no energy is lost or gained. fresnel_product: diffuse is multiplied by what single Fresnel terms let
through, once for each direction, which loses up to 59 % (Solari, Bevy 0.19); Fresnel's terms are those of the surface
without a thin film, so that films dim no diffuse light below them."""


class Surfaces(Protocol):
    """The settings that surfaces follow."""

    @property
    def layering(self) -> str: ...
    @property
    def lambert(self) -> bool: ...


def brdf_constants(settings: Surfaces) -> dict[str, int | bool]:
    """The specialization constants of every pass that evaluates the BRDF."""
    # Constants of the pipeline, not uniforms: drivers then drop the branch that isn't taken.
    return {"brdf_layering": LAYERINGS.index(settings.layering), "lambertian_surfaces": settings.lambert}


def glsl_header() -> str:
    """`const uint LAYERING_CONSERVING = 0u;` and so on: the values of the specialization constant brdf_layering."""
    return enumeration("LAYERING", LAYERINGS)
