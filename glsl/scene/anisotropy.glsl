// Anisotropic GGX: the functions of scene/microfacet.glsl with one roughness along x and another along y.
#ifndef SCENE_ANISOTROPY_GLSL
#define SCENE_ANISOTROPY_GLSL

#include "scene/microfacet.glsl"

float D_GGX(vec2 roughness, vec3 half_vector) {
    vec2 slope = half_vector.xy / roughness;
    float spread = dot(slope, slope) + square(half_vector.z);
    return INVERSE_PI / (roughness.x * roughness.y * square(spread));
}

float V_SmithGGXCorrelated(vec2 roughness, vec3 wo, vec3 wi) {
    float shadowed_i = wo.z * length(vec3(roughness * wi.xy, wi.z));
    float shadowed_o = wi.z * length(vec3(roughness * wo.xy, wo.z));
    return 0.5 / max(shadowed_i + shadowed_o, 1e-30);
}

// The factor k of bounded sampling: Eto and Tokuyoshi (2023), equation 5.
float vndf_bound(vec3 wo, vec2 roughness) {
    float a2 = square(min(roughness.x, roughness.y));
    float s2 = square(1.0 + length(wo.xy));
    return (1.0 - a2) * s2 / (s2 + a2 * square(wo.z));
}

vec3 sample_ggx_vndf(vec3 wo, vec2 roughness, vec2 u) {
    vec3 wo_std = normalize(vec3(wo.xy * roughness, wo.z));
    float b = vndf_bound(wo, roughness) * wo_std.z;
    float z = (1.0 - u.y) * (1.0 + b) - b;
    float phi = 2.0 * PI * u.x;
    vec3 m_std = wo_std + vec3(safe_sqrt(1.0 - z * z) * vec2(cos(phi), sin(phi)), z);
    vec3 m = normalize(vec3(m_std.xy * roughness, m_std.z));
    return 2.0 * dot(wo, m) * m - wo;
}

float ggx_vndf_pdf_per_d(vec3 wo, vec2 roughness) {
    return 0.5 / (vndf_bound(wo, roughness) * wo.z + length(vec3(wo.xy * roughness, wo.z)));
}

#endif
