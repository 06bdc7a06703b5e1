// How much a light sample matters to a surface, without shadows.
#ifndef PASSES_RESTIR_DI_TARGET_GLSL
#define PASSES_RESTIR_DI_TARGET_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "passes/restir_di/reservoir.glsl"
#include "scene/sampling.glsl"

// Luminance of what a matte surface that reflects as much would send on. Differs from Solari, which takes the diffuse lobe alone:
// positive wherever the BRDF is, so that metals have direct light too.
float di_target(GBufferSurface surface, ResolvedLightSample resolved) {
    LightContribution light = calculate_resolved_light_contribution(resolved, surface.world_position);
    if (!(dot(light.wi, surface.geometric_world_normal) > 0.0)) { return 0.0; }
    vec3 dielectric_f0 = 0.16 * surface.material.reflectance * surface.material.reflectance;
    vec3 color = max(surface.material.base_color + (1.0 - surface.material.metallic) * dielectric_f0, 0.01);
    float cosine = max(dot(light.wi, surface.world_normal), 0.0);
    float inverse_pdf = light.inverse_pdf / float(max(scene_info.light_count, 1u));  // over a light's random numbers
    float target = luminance(color * light.received_radiance) * (INVERSE_PI * cosine * inverse_pdf);
    return target > 1e-30 ? min(target, 1e30) : 0.0;  // so that neither it nor its inverse is infinite
}

float di_target(GBufferSurface surface, DiReservoir reservoir) {
    if (reservoir.light_sample.light_index == NO_INDEX) { return 0.0; }
    return di_target(surface, resolve_light_sample(reservoir.light_sample));
}

// At a surface of the last frame: 0 for lights that weren't there, which nothing found there can have come from.
float previous_di_target(GBufferSurface surface, DiReservoir reservoir) {
    uint light_index = reservoir.light_sample.light_index;
    return light_index == NO_INDEX || previous_light.at[light_index] == NO_INDEX ? 0.0 : di_target(surface, reservoir);
}

#endif
