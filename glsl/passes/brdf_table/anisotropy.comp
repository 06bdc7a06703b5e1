// Computes the directional albedo of single-scattering GGX of a white anisotropic metal: a quadrature over bounded VNDF
// samples, as passes/brdf_table/integrate.comp.
#version 460
#include "scene/microfacet.glsl"
#include "scene/brdf_table.glsl"

layout(local_size_x = 11, local_size_y = 11) in;

const uint POINT_COUNT = 256u;
const float GOLDEN_RATIO = 0.618033988749895;

void main() {
    uvec3 cell = gl_GlobalInvocationID;
    uint size = ANISOTROPY_TABLE_SIZE;
    if (any(greaterThanEqual(cell, uvec3(size, size, size * size)))) { return; }
    vec2 position = vec2(cell.xy) / float(size - 1u);
    vec2 material = vec2(cell.z % size, cell.z / size) / float(size - 1u);
    float across = max(square(material.x), MIRROR_ROUGHNESS);
    vec2 roughness = vec2(mix(across, 1.0, square(material.y)), across);
    float cosine = max(square(position.x), 1e-4);
    vec3 wo = vec3(safe_sqrt(1.0 - cosine * cosine) * vec2(position.y, safe_sqrt(1.0 - square(position.y))), cosine);
    float pdf_per_d = ggx_vndf_pdf_per_d(wo, roughness);
    float albedo = 0.0;
    for (uint i = 0u; i < POINT_COUNT; i++) {
        float from_end = 1.0 - (float(i) + 0.5) / float(POINT_COUNT);
        vec2 u = vec2(fract(float(i) * GOLDEN_RATIO), 1.0 - from_end * from_end);
        vec3 wi = sample_ggx_vndf(wo, roughness, u);
        if (wi.z > 0.0) { albedo += 2.0 * from_end * V_SmithGGXCorrelated(roughness, wo, wi) * wi.z / pdf_per_d; }
    }
    anisotropy_table.at[(cell.z * size + cell.y) * size + cell.x] = albedo / float(POINT_COUNT);
}
