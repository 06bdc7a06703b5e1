// The GGX microfacet distribution and how to sample it, in the frame whose z axis is the shading normal; with one
// roughness, or with one along x and another along y.
#ifndef SCENE_MICROFACET_GLSL
#define SCENE_MICROFACET_GLSL

#include "common/math.glsl"

// A surface of at most this roughness is a perfect mirror.
const float MIRROR_ROUGHNESS = 0.001;

// The squared sine is computed from x and y: at roughness 0.001, 1 - cos^2 would be off by 12 %.
float D_GGX(float roughness, vec3 half_vector) {
    float a2 = square(roughness);
    float spread = dot(half_vector.xy, half_vector.xy) + a2 * square(half_vector.z);
    return INVERSE_PI * a2 / square(spread);
}

float V_SmithGGXCorrelated(float roughness, float NdotV, float NdotL) {
    float a2 = square(roughness);
    float shadowed_l = NdotV * sqrt(a2 + (1.0 - a2) * square(NdotL));
    float shadowed_v = NdotL * sqrt(a2 + (1.0 - a2) * square(NdotV));
    return 0.5 / max(shadowed_l + shadowed_v, 1e-30);
}

vec3 fresnel(vec3 f0, float LdotH) {
    float x = saturate(1.0 - LdotH);
    float x2 = x * x;
    return f0 + (1.0 - f0) * (x2 * x2 * x);
}

// The Fresnel reflectance of a dielectric at normal incidence.
vec3 reflectance_f0(vec3 reflectance) { return min(0.16 * reflectance * reflectance, 1.0); }

// The exact reflectance of a dielectric with a relative index of refraction `eta`.
float dielectric_fresnel(float eta, float cosine) {
    float g2 = square(eta) - 1.0 + square(cosine);
    if (!(g2 > 0.0)) { return 1.0; }  // total internal reflection
    float g = sqrt(g2);
    float a = (g - cosine) / (g + cosine);
    float b = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

// The factor of reflections by glass whose F0 isn't that of its index of refraction.
vec3 glass_tint(float ior, vec3 f0) {
    float own_f0 = square((ior - 1.0) / (ior + 1.0));
    return own_f0 > 1e-5 ? min(f0 / own_f0, 1.0) : vec3(1.0);
}

// A microfacet normal as wo sees them: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps" (2023).
// `bound` below 1 leaves out normals that reflect below the surface: Eto and Tokuyoshi, "Bounded VNDF Sampling for
// Smith-GGX Reflections" (SIGGRAPH Asia 2023), listing 1. `roughness` is that along x and along y.
vec3 sample_visible_normal(vec3 wo, vec2 roughness, float bound, vec2 u) {
    vec3 wo_std = normalize(vec3(wo.xy * roughness, wo.z));
    float b = bound * wo_std.z;
    float z = (1.0 - u.y) * (1.0 + b) - b;
    float phi = 2.0 * PI * u.x;
    vec3 m_std = wo_std + vec3(safe_sqrt(1.0 - z * z) * vec2(cos(phi), sin(phi)), z);
    return normalize(vec3(m_std.xy * roughness, m_std.z));
}

// The factor k of bounded sampling: equation 5.
float vndf_bound(vec3 wo, vec2 roughness) {
    float a2 = square(min(roughness.x, roughness.y));
    float s2 = square(1.0 + length(wo.xy));
    return (1.0 - a2) * s2 / (s2 + a2 * square(wo.z));
}

// Samples the reflected direction for a view direction. Samples with z <= 0 are invalid and contribute nothing; the pdf
// integrates to the share of valid samples.
vec3 sample_ggx_vndf(vec3 wo, vec2 roughness, vec2 u) {
    vec3 m = sample_visible_normal(wo, roughness, vndf_bound(wo, roughness), u);
    return 2.0 * dot(wo, m) * m - wo;
}

vec3 sample_ggx_vndf(vec3 wo, float roughness, vec2 u) { return sample_ggx_vndf(wo, vec2(roughness), u); }

// The pdf of sample_ggx_vndf divided by D_GGX (listing 2, for wo above the surface).
float ggx_vndf_pdf_per_d(vec3 wo, float roughness) {
    float spread = square(roughness) * dot(wo.xy, wo.xy) + square(wo.z);
    return 0.5 / (vndf_bound(wo, vec2(roughness)) * wo.z + sqrt(spread));
}

// ---- anisotropic: the same functions ----------------------------------------------------------------

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

float ggx_vndf_pdf_per_d(vec3 wo, vec2 roughness) {
    return 0.5 / (vndf_bound(wo, roughness) * wo.z + length(vec3(wo.xy * roughness, wo.z)));
}

#endif
