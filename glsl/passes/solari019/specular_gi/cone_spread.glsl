// The specular lobe alone: how to sample it, and how much it spreads a path.
#ifndef PASSES_SOLARI019_SPECULAR_GI_CONE_SPREAD_GLSL
#define PASSES_SOLARI019_SPECULAR_GI_CONE_SPREAD_GLSL

#include "common/math.glsl"
#include "scene/brdf.glsl"

BrdfSample sample_specular_brdf(Brdf brdf, vec3 wo, inout uint rng) {
    if (SCENE_LOBES) { return sample_brdf(without_diffuse_lobe(brdf), wo, rng); }
    if (is_mirror(brdf.specular)) {
        return delta_sample(vec3(-wo.xy, wo.z), specular_fresnel(brdf.specular, wo.z));
    }
    vec3 wi = sample_specular(brdf.specular, wo, rand_vec2f(rng));
    float pdf = specular_pdf(brdf.specular, wo, wi);
    return without_values(wi, pdf > 0.0 ? evaluate_specular_brdf(brdf, wo, wi) / pdf : vec3(0.0), pdf, false);
}

// The squared slope of the cone into which a lobe spreads a path, as NVIDIA's RTXGI computes it to end paths in its
// radiance cache (SHARC). Differs from SHARC: squares add up over a path, and the cone goes on widening after a mirror.
float cone_spread_of_lobe(float roughness) {
    float a2 = square(min(roughness, 0.99));
    return 0.5 * a2 / (1.0 - a2);
}

// The same with Solari's clamp, which limits the square of the roughness.
float solari_cone_spread_of_lobe(float roughness) {
    float a2 = min(square(roughness), 0.99);
    return 0.5 * a2 / (1.0 - a2);
}

#endif
