"""What Solari in Bevy 0.17 and 0.18 did otherwise, as patches for `patched_shaders`: tests compare with it."""

from __future__ import annotations

from solari_vk.gpu.shaders.patches import Patch

_SHADE_DI = "passes/restir_di/spatial_and_shade.comp"
_TRACE, _LOBE = "passes/specular_gi/trace.comp", "passes/specular_gi/lobe.glsl"

CONSTANT_WEIGHTS: tuple[Patch, ...] = (
    ("passes/restir_di/reservoir.glsl", "vec2 weights = confidences * targets;", "vec2 weights = confidences;"),
)
"""ReSTIR DI's merge weights are the confidences, without the targets."""

VISIBILITY_FED_FORWARD: tuple[Patch, ...] = (
    (_SHADE_DI, "    reservoir = merge_di_reservoirs(reservoir, other, here, there, rng);\n",
     "    if (here.y > 0.0 && transmittance(surface, resolve_light_sample(other.light_sample)) == vec3(0.0)) {\n"
     "        other.unbiased_contribution_weight = 0.0;\n"
     "    }\n"
     "    reservoir = merge_di_reservoirs(reservoir, other, here, there, rng);\n"),
    (_SHADE_DI, "= transmittance(surface, resolved);", "= vec3(1.0);"),
)  # fmt: skip
"""ReSTIR DI tests the visibility of the spatial sample before the merge, and none after it."""

LOBES_ADDED: tuple[Patch, ...] = (
    ("scene/brdf.glsl",
     "value *= (1.0 - fresnel(brdf.dielectric_f0, wo.z)) * (1.0 - fresnel(brdf.dielectric_f0, wi.z));", ""),
)  # fmt: skip
"""The BRDF adds its two lobes where layering is `fresnel_product`."""

CLAMPED_GGX: tuple[Patch, ...] = (
    (_LOBE, "float lobe_spread(float roughness) {",
     """// Bevy 0.18's estimate of a mirror, over its Fresnel term: GGX at roughness 0.001 over the pdf of the sample.
// Both have D at its peak, from cosines in different frames, and rounding makes each 1 - cos^2 as large as alpha^2.
float clamped_ggx_factor(vec3 wo, vec3 world_normal, vec3 world_wo, vec3 world_wi) {
    vec3 wi = vec3(-wo.xy, wo.z);
    float a2 = square(MIRROR_ROUGHNESS);
    vec2 cosines = vec2(dot(world_normal, normalize(world_wo + world_wi)), normalize(wo + wi).z);
    vec2 spreads = (1.0 - cosines * cosines) + a2 * cosines * cosines;
    return V_SmithGGXCorrelated(MIRROR_ROUGHNESS, wo.z, wi.z) * wi.z / ggx_vndf_pdf_per_d(wo, MIRROR_ROUGHNESS)
        * square(spreads.y / spreads.x);
}

float lobe_spread(float roughness) {"""),
    (_TRACE, "    path.direction = normalize(frame * next.wi);\n",
     """    vec3 world_wo = -path.direction;
    path.direction = normalize(frame * next.wi);
    if (next.pdf == INFINITY) {
        path.throughput *= clamped_ggx_factor(world_wo * frame, frame[2], world_wo, path.direction);
    }
"""),
)  # fmt: skip
"""Mirrors are GGX of roughness 0.001, sampled in the mirrored direction."""
