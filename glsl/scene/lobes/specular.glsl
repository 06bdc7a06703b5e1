// The specular lobe: GGX with multiple scattering, of a metal or of a dielectric over the diffuse lobe.
#ifndef SCENE_LOBES_SPECULAR_GLSL
#define SCENE_LOBES_SPECULAR_GLSL

#include "scene/lobes/types.glsl"
#include "scene/microfacet.glsl"

// By how much A and B of an anisotropic lobe exceed those of the table at most, over the square of its strength.
const vec2 ANISOTROPY_BOUND = vec2(0.38, 0.67);

// The roughness along and across the direction of anisotropy: KHR_materials_anisotropy.
vec2 anisotropic_roughness(ResolvedMaterial material) {
    return vec2(mix(material.roughness, 1.0, square(material.lobes.anisotropy)), material.roughness);
}

// The perceptual roughness under which tables have the albedo of the specular lobe: for an anisotropic lobe that of the
// same mean squared roughness.
float table_roughness(ResolvedMaterial material) {
    if (!SCENE_LAYERS || material.lobes.anisotropy == 0.0) { return material.perceptual_roughness; }
    vec2 roughness = anisotropic_roughness(material);
    return sqrt(sqrt(0.5 * dot(roughness, roughness)));
}

vec3 to_anisotropy(Brdf brdf, vec3 v) {
    vec2 along = brdf.anisotropy_direction;
    return vec3(dot(along, v.xy), along.x * v.y - along.y * v.x, v.z);
}

vec3 from_anisotropy(Brdf brdf, vec3 v) {
    vec2 along = brdf.anisotropy_direction;
    return vec3(along * v.x + vec2(-along.y, along.x) * v.y, v.z);
}

// A and B towards a direction. At grazing angles an anisotropic lobe has the albedo of its roughness in that direction.
vec2 albedo_terms(Brdf brdf, vec3 w) {
    if (!SCENE_LAYERS || brdf.mirror) { return albedo_terms(brdf.mirror, brdf.perceptual_roughness, w.z); }
    vec3 mean = vec3(brdf.anisotropic_roughness, square(brdf.perceptual_roughness));
    return lookup_brdf_table(w.z, sqrt(length(mean * to_anisotropy(brdf, w))));
}

// The share of uniform light that a dielectric's specular lobe reflects towards a direction, from A and B there. The
// factors of an anisotropic lobe bound its A and B over those of the table, measured for all directions, so that no
// energy is gained.
vec3 dielectric_albedo(Brdf brdf, vec2 ab) {
    vec3 albedo = specular_albedo(brdf.dielectric_f0, ab);
    if (!SCENE_LAYERS || brdf.mirror) { return brdf.layer_weight * albedo; }
    vec3 reflected = brdf.dielectric_f0 * ab.x;
    vec3 excess = (ANISOTROPY_BOUND.x * reflected + ANISOTROPY_BOUND.y * ab.y) / max(reflected + ab.y, 1e-30);
    return brdf.layer_weight * min(albedo * (1.0 + square(brdf.anisotropy) * excess), 1.0);
}

// Fresnel of metal and dielectric, mixed last, with multiple scattering.
vec3 specular_fresnel(Brdf brdf, float LdotH) {
    vec3 dielectric = fresnel(brdf.dielectric_f0, LdotH) * (1.0 + brdf.dielectric_f0 * brdf.multiscatter);
    vec3 metal = fresnel(brdf.metal_f0, LdotH) * (1.0 + brdf.metal_f0 * brdf.multiscatter);
    if (HAS_LOBES) { dielectric *= brdf.layer_weight * (1.0 - brdf.transmission); }
    return mix(dielectric, metal, brdf.metallic);
}

// D of the specular lobe; pdf_per_d times it is the density of sample_specular_lobe.
float specular_distribution(Brdf brdf, vec3 half_vector) {
    if (SCENE_LAYERS) { return D_GGX(brdf.anisotropic_roughness, to_anisotropy(brdf, half_vector)); }
    return D_GGX(brdf.roughness, half_vector);
}

vec3 sample_specular_lobe(Brdf brdf, vec3 wo, vec2 u) {
    if (!SCENE_LAYERS) { return sample_ggx_vndf(wo, brdf.roughness, u); }
    return from_anisotropy(brdf, sample_ggx_vndf(to_anisotropy(brdf, wo), brdf.anisotropic_roughness, u));
}

float specular_pdf(Brdf brdf, vec3 wo, vec3 wi) {
    return brdf.mirror || !(wi.z > 0.0) ? 0.0 : brdf.pdf_per_d * specular_distribution(brdf, normalize(wo + wi));
}

// 0 for the one direction to which a mirror reflects.
vec3 evaluate_specular_lobe(Brdf brdf, vec3 wo, vec3 wi) {
    if (brdf.mirror || !(wi.z > 0.0)) { return vec3(0.0); }
    vec3 half_vector = normalize(wo + wi);
    float V = SCENE_LAYERS
        ? V_SmithGGXCorrelated(brdf.anisotropic_roughness, to_anisotropy(brdf, wo), to_anisotropy(brdf, wi))
        : V_SmithGGXCorrelated(brdf.roughness, wo.z, wi.z);
    return specular_fresnel(brdf, dot(wi, half_vector)) * (specular_distribution(brdf, half_vector) * V * wi.z);
}

#endif
