// The diffuse lobe: Lambert, below the dielectric part of the specular lobe.
#ifndef SCENE_LOBES_DIFFUSE_GLSL
#define SCENE_LOBES_DIFFUSE_GLSL

#include "common/random.glsl"
#include "generated/settings/layering.glsl"  // LAYERING_*, written by solari_vk/settings/layering.py
#include "scene/base_material.glsl"
#include "scene/lobes/specular.glsl"

layout(constant_id = brdf_layering_id) const uint brdf_layering = LAYERING_CONSERVING;

struct Diffuse {
    vec3 color;  // for LAYERING_CONSERVING reduced by what the specular lobe reflects towards wo
};

// The share of uniform incoming light that a lobe of this color takes, below a dielectric that reflects the share
// `dielectric`.
vec3 diffuse_albedo(vec3 color, BaseMaterial base, vec3 dielectric, float cosine) {
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        // 20/21 (1 - f0) is the cosine-weighted mean of 1 - fresnel over the hemisphere.
        vec3 f0 = reflectance_f0(base.reflectance);
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);
    }
    return through * color;
}

// A diffuse lobe of this color below a dielectric that reflects the share `dielectric` towards wo.
Diffuse prepare_diffuse(vec3 color, Specular specular, vec3 dielectric) {
    if (brdf_layering == LAYERING_CONSERVING && specular.metallic < 1.0) {
        // Differs from Solari: (1 - E(wo)) (1 - E(wi)) / (1 - E_average) is reciprocal and loses no energy
        color *= (1.0 - dielectric) / max(1.0 - average_dielectric_albedo(specular), 1e-3);
    }
    return Diffuse(color);
}

// wo and wi are above the surface.
vec3 evaluate_diffuse(Diffuse diffuse, Specular specular, vec3 wo, vec3 wi) {
    vec3 value = diffuse.color * (INVERSE_PI * wi.z);
    if (lambertian_surfaces || specular.metallic == 1.0) { return value; }
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        // Differs from Solari, which mixes F0 with the base color: here metal has a share of its own.
        vec3 f0 = specular.dielectric_f0;
        return value * ((1.0 - fresnel(f0, wo.z)) * (1.0 - fresnel(f0, wi.z)));
    }
    return value * (1.0 - dielectric_albedo(specular, albedo_terms(specular, wi), wi.z));
}

float diffuse_pdf(vec3 wi) { return INVERSE_PI * wi.z; }

vec3 sample_diffuse(vec2 u) { return sample_cosine_hemisphere(u); }

#endif
