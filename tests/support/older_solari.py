"""Behaviors of earlier versions of Solari, which tests compare with."""

from support.seeded_bugs import Bug

LOBES_ADDED = Bug(
    "scene/brdf.glsl",
    "evaluate_diffuse_brdf",
    "if (brdf_layering == LAYERING_FRESNEL_PRODUCT && wo.z > 0.0 && wi.z > 0.0) "
    "{ return brdf.diffuse.color * (INVERSE_PI * wi.z); } return correct(brdf, wo, wi);",
)
"""The BRDF adds its two lobes where layering is `fresnel_product`, as in Bevy 0.18."""
