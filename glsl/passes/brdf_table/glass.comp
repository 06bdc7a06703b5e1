// Computes the directional albedo of white glass with single scattering: a quadrature over visible microfacet normals.
// Turquin, "Practical Multiple Scattering Compensation for Microfacet Models" (2019), divides by it.
#version 460
#include "scene/brdf_table.glsl"
#include "scene/lobes/glass.glsl"

layout(local_size_x = 4, local_size_y = 4, local_size_z = 4) in;

const uint POINT_COUNT = 512u;  // of a golden-ratio lattice, as in passes/brdf_table/integrate.comp
const float GOLDEN_RATIO = 0.618033988749895;

// The share of light from a microfacet that leaves the surface on the side of wi.
float unshadowed(Glass glass, vec3 wo, vec3 wi, bool reflected) {
    if (reflected ? !(wi.z > 0.0) : !(wi.z < 0.0)) { return 0.0; }
    float seen = 1.0 + smith_lambda(glass.roughness, wo);
    return seen / (seen + smith_lambda(glass.roughness, wi));
}

void main() {
    uvec3 cell = gl_GlobalInvocationID;
    if (any(greaterThanEqual(cell, uvec3(uvec2(GLASS_TABLE_SIZE), GLASS_TABLE_SLICES)))) { return; }
    vec2 position = vec2(cell.xy) / float(GLASS_TABLE_SIZE - 1u);
    float slice = 2.0 * float(cell.z) / float(GLASS_TABLE_SLICES - 1u) - 1.0;
    float ratio = LARGEST_ETA_RATIO * slice * abs(slice);
    float cosine = max(square(position.x), 1e-4);
    Glass glass;
    glass.eta = (1.0 + ratio) / (1.0 - ratio);
    glass.thin = false;
    glass.roughness = max(square(position.y), MIRROR_ROUGHNESS);
    glass.color = glass.tint = vec3(1.0);
    vec3 wo = vec3(safe_sqrt(1.0 - cosine * cosine), 0.0, cosine);
    vec2 albedo = vec2(0.0);  // without and with the reflections of dielectrics
    for (uint i = 0u; i < POINT_COUNT; i++) {
        vec2 u = vec2(0.5 * fract(float(i) * GOLDEN_RATIO), (float(i) + 0.5) / float(POINT_COUNT));
        vec3 m = sample_visible_normal(wo, vec2(glass.roughness), 1.0, u);
        float along = dot(wo, m);
        float reflected = dielectric_fresnel(glass.eta, along);
        float above = unshadowed(glass, wo, 2.0 * along * m - wo, true);
        float below = unshadowed(glass, wo, refract_through(glass, wo, m), false);
        albedo += mix(vec2(below), vec2(above), vec2(reflected < 1.0 ? 0.0 : 1.0, reflected));
    }
    glass_table.at[(cell.z * GLASS_TABLE_SIZE + cell.y) * GLASS_TABLE_SIZE + cell.x] = albedo / float(POINT_COUNT);
}
