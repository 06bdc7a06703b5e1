"""How the diffuse lobe of a surface lies under its specular lobe."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import enumeration

LAYERINGS = ("conserving", "sum", "fresnel_product")
"""conserving: no energy is lost or gained. sum: both lobes are added, which gains up to 49 % (Solari, Bevy 0.18).
fresnel_product: diffuse is multiplied by what single Fresnel terms let through, which loses up to 59 % (Bevy 0.19)."""


def glsl_header() -> str:
    """`const uint LAYERING_CONSERVING = 0u;` and so on: the values of the specialization constant brdf_layering."""
    return enumeration("LAYERING", LAYERINGS)
