// Directional albedo of single-scattering GGX for F0 split into A and B (Karis, "Real Shading in Unreal Engine 4", 2013), by
// midpoint quadrature over bounded VNDF samples, whose weights are smooth.
#version 460
#include "passes/bindings.glsl"
#include "scene/brdf_table.glsl"
#include "scene/microfacet.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Around the normal the integrand is periodic and a few points suffice; the other way it ends in a kink.
const uvec2 POINT_COUNT = uvec2(8u, 128u);

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
        for (uint i = 0u; i < POINT_COUNT.x * POINT_COUNT.y; i++) {
            vec2 u = (vec2(i % POINT_COUNT.x, i / POINT_COUNT.x) + 0.5) / vec2(POINT_COUNT);
            u.x *= 0.5;  // the other half is its mirror image
            vec3 wi = sample_ggx_vndf(wo, roughness, u);
            if (!(wi.z > 0.0)) { continue; }
            float weight = V_SmithGGXCorrelated(roughness, wo.z, wi.z) * wi.z / pdf_per_d;
            albedo += weight * mirror_albedo(dot(wi, normalize(wo + wi)));
        }
        albedo /= float(POINT_COUNT.x * POINT_COUNT.y);
    }
    brdf_table.at[cell.y * BRDF_TABLE_SIZE + cell.x] = albedo;
}
