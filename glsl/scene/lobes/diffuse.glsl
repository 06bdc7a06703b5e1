// The diffuse lobe: Lambert, below the dielectric part of the specular lobe.
#ifndef SCENE_LOBES_DIFFUSE_GLSL
#define SCENE_LOBES_DIFFUSE_GLSL

#include "common/random.glsl"
#include "scene/lobes/specular.glsl"

// The share of uniform incoming light that it reflects, below a dielectric that reflects the share `dielectric`.
vec3 diffuse_albedo(ResolvedMaterial material, vec3 dielectric, float cosine) {
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        // 20/21 (1 - f0) is the cosine-weighted mean of 1 - fresnel over the hemisphere.
        vec3 f0 = reflectance_f0(material.reflectance);
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);
    }
    return through * (material.base_color * (1.0 - material.metallic));
}

// wo and wi are above the surface.
vec3 evaluate_diffuse_lobe(Brdf brdf, vec3 wo, vec3 wi) {
    vec3 value = brdf.diffuse_color * (INVERSE_PI * wi.z);
    if (brdf_lambert || brdf.metallic == 1.0) { return value; }
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        return value * ((1.0 - fresnel(brdf.dielectric_f0, wo.z)) * (1.0 - fresnel(brdf.dielectric_f0, wi.z)));
    }
    return value * (1.0 - dielectric_albedo(brdf, albedo_terms(brdf, wi)));
}

float diffuse_pdf(vec3 wi) { return INVERSE_PI * wi.z; }

vec3 sample_diffuse_lobe(vec2 u) { return sample_cosine_hemisphere(u); }

#endif
