// Computes the directional albedo of single-scattering GGX as F0 A + B: Karis, "Real Shading in Unreal Engine 4"
// (2013). It is a quadrature over bounded VNDF samples, whose weights are smooth except for a kink at the horizon.
#version 460
#include "scene/brdf_table.glsl"
#include "scene/microfacet.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Points of a golden-ratio lattice. A regular grid of as many points has ten times the error, because the integrand
// has a kink.
const uint POINT_COUNT = 1024u;
const float GOLDEN_RATIO = 0.618033988749895;

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(cell, uvec2(BRDF_TABLE_SIZE)))) { return; }
    vec2 position = vec2(cell) / float(BRDF_TABLE_SIZE - 1u);
    float NdotV = max(square(position.x), 1e-4);
    float roughness = square(position.y);
    vec2 albedo = vec2(0.0);
    if (roughness <= MIRROR_ROUGHNESS) {
        albedo = mirror_albedo(square(position.x));
    } else {
        vec3 wo = vec3(safe_sqrt(1.0 - NdotV * NdotV), 0.0, NdotV);
        float pdf_per_d = ggx_vndf_pdf_per_d(wo, roughness);
        for (uint i = 0u; i < POINT_COUNT; i++) {
            // Half the azimuths, as the others mirror them; denser near the horizon, where weights vary most.
            float from_end = 1.0 - (float(i) + 0.5) / float(POINT_COUNT);
            vec2 u = vec2(0.5 * fract(float(i) * GOLDEN_RATIO), 1.0 - from_end * from_end);
            vec3 wi = sample_ggx_vndf(wo, roughness, u);
            if (!(wi.z > 0.0)) { continue; }
            float weight = 2.0 * from_end * V_SmithGGXCorrelated(roughness, wo.z, wi.z) * wi.z / pdf_per_d;
            albedo += weight * mirror_albedo(dot(wi, normalize(wo + wi)));
        }
        albedo /= float(POINT_COUNT);
    }
    imageStore(brdf_table, ivec2(cell), vec4(albedo, 0.0, 0.0));
}
