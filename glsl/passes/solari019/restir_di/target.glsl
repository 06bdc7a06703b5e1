// The target function of ReSTIR DI: the luminance that a light sample adds to a pixel, without visibility.
#ifndef PASSES_SOLARI019_RESTIR_DI_TARGET_GLSL
#define PASSES_SOLARI019_RESTIR_DI_TARGET_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "passes/solari019/restir_di/reservoir.glsl"
#include "scene/brdf.glsl"
#include "scene/sampling.glsl"

// Whether DI shades the specular lobe. On smooth surfaces rays of that lobe find the lights that rays can meet.
bool di_shades_specular(ResolvedMaterial material, uint light_kind) {
    return material.base.roughness > specular_gi_settings.di_roughness || !can_be_hit_by_rays(light_kind);
}

// The specular lobe, if DI shades it. Color and multiple scattering are left out, because they would cost time and
// change little.
float specular_target(GBufferSurface surface, uint light_kind, vec3 dielectric_f0, vec3 world_wi) {
    BaseMaterial base = surface.material.base;
    if (lambertian_surfaces || restir_di_settings.target == DI_TARGET_MATTE) { return 0.0; }
    if (base.roughness <= MIRROR_ROUGHNESS || !di_shades_specular(surface.material, light_kind)) { return 0.0; }
    mat3 frame = orthonormalize(surface.world_normal);
    vec3 wo = surface.wo * frame, wi = world_wi * frame;
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return 0.0; }
    vec3 half_vector = normalize(wo + wi);
    float f0 = luminance(mix(dielectric_f0, base.color, base.metallic));
    return fresnel(vec3(f0), dot(wi, half_vector)).x * D_GGX(base.roughness, half_vector)
        * V_SmithGGXCorrelated(base.roughness, wo.z, wi.z);
}

const float MIN_DI_TARGET = 1e-30;  // so that neither a target nor 1 / target is infinite

// About the luminance that the surface reflects of the sample, divided by the sample's probability density. Differs
// from Solari, which takes the diffuse lobe alone (di_target=matte): that seldom chooses the lights of highlights.
// Specular colors count as diffuse too, with a minimum, so that the weight is positive for each light that the BRDF
// reflects.
float di_weight(GBufferSurface surface, ResolvedLightSample resolved) {
    LightContribution light = calculate_resolved_light_contribution(resolved, surface.world_position);
    if (!(dot(light.wi, surface.geometric_world_normal) > 0.0)) { return 0.0; }
    vec3 dielectric_f0 = reflectance_f0(surface.material.base.reflectance);
    vec3 color = max(surface.material.base.color + (1.0 - surface.material.base.metallic) * dielectric_f0, 0.01);
    float cosine = max(dot(light.wi, surface.world_normal), 0.0);
    if (SCENE_LAYERS && surface.material.coat.weight > 0.0) {  // has a normal of its own
        vec3 wi = light.wi * orthonormalize(surface.world_normal);
        cosine = max(cosine, dot(wi, surface.material.coat.normal));
    }
    vec3 brdf = INVERSE_PI * color + specular_target(surface, resolved.kind, dielectric_f0, light.wi);
    return min(
        luminance(brdf * light.radiance_in_area_measure) * (cosine * light.inverse_area_pdf), 1.0 / MIN_DI_TARGET
    );
}

// The target of a sample with this weight.
float di_target(float weight, LightSample light_sample) {
    float target = weight * light_sample_probability(light_sample);
    return target > MIN_DI_TARGET ? target : 0.0;
}

float di_target(GBufferSurface surface, DiReservoir reservoir) {
    if (reservoir.light_sample.light_index == NO_INDEX) { return 0.0; }
    return di_target(di_weight(surface, resolve_light_sample(reservoir.light_sample)), reservoir.light_sample);
}

// The target at a surface of the previous frame: 0 for lights that didn't exist then.
float previous_di_target(GBufferSurface surface, DiReservoir reservoir) {
    uint light_index = reservoir.light_sample.light_index;
    return light_index == NO_INDEX || previous_light.at[light_index] == NO_INDEX ? 0.0 : di_target(surface, reservoir);
}

#endif
