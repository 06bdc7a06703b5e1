"""Behaviors of Solari in Bevy 0.17 and 0.18 that the shaders no longer have, as patches for `patched_shaders`."""

from __future__ import annotations

from support.patches import Patch

_TILES = "passes/light_tiles/light_tiles.glsl"
_SHADE_DI = "passes/restir_di/spatial_and_shade.comp"
_TRACE, _LOBE = "passes/specular_gi/trace.comp", "passes/specular_gi/lobe.glsl"

# Bevy 0.17
NO_TILES: tuple[Patch, ...] = (
    (_TILES, "    uint index = tile *", "    return draw_light_candidate(rng);\n    uint index = tile *"),
)
"""Each candidate of RIS is drawn and resolved in the pass that uses it. The tiles are still generated, but not read."""

LINEAR_TILES: tuple[Patch, ...] = (
    (_TILES, " pack_radiance_log2_rgb9e5(resolved.radiance, this_frame.exposure)",
     " pack_rgb9e5(resolved.radiance * this_frame.exposure)"),
    (_TILES, " unpack_radiance_log2_rgb9e5(packed.radiance, this_frame.exposure)",
     " unpack_rgb9e5(packed.radiance) / this_frame.exposure"),
)  # fmt: skip
"""Light tiles hold exposed radiance as rgb9e5, without the logarithm."""

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

FIXED_BLEND: tuple[Patch, ...] = (
    ("passes/world_cache/blend.comp", "mix(max_samples, 1.0, ", "mix(max_samples, max_samples, "),
)
"""The world cache averages as many frames where light changes as where it doesn't."""

STORED_LIFETIME: tuple[Patch, ...] = (
    ("passes/world_cache/sample_indirect.comp", "uint lifetime = world_cache_samples.at[thread].life & ~SEES_WALL;",
     "uint lifetime = world_cache_settings.lifetime;"),
)  # fmt: skip
"""World cache cells that are queried by other cells live as long as those that pixels query."""

# Bevy 0.18
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

NO_SHORT_RAY_RULE: tuple[Patch, ...] = (("passes/world_cache/query.glsl", "if (ray_t < cell_size) {", "if (false) {"),)
"""World cache queries of short rays use the same cell size as those of long rays."""

TERMINATION_BY_ROUGHNESS: tuple[Patch, ...] = (
    (_TRACE, "return spread_width > cell_size && ray_t > (as_solari ? sqrt(3.0) : 1.0) * cell_size;",
     "return surface.material.roughness > 0.03;"),
)  # fmt: skip
"""Specular paths end in the world cache at the first surface that isn't nearly a mirror."""
