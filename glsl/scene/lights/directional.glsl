// Lights that are disks at infinity, such as the sun.
#ifndef SCENE_LIGHTS_DIRECTIONAL_GLSL
#define SCENE_LIGHTS_DIRECTIONAL_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/types.glsl"

struct DirectionalLight {
    vec3 direction_to_light;
    float one_minus_cos_half_angle;  // precise even for disks as small as a star
    // Differs from Solari: illuminance / (pi sin^2), so that a surface facing a wide disk gets exactly its illuminance
    vec3 radiance;
    float solid_angle;
};

layout(set = 0, scalar) readonly buffer DirectionalLightsBlock {
    DirectionalLight at[];
} directional_lights;

ResolvedLightSample resolve_directional(uint index, uint part, vec2 u, float inverse_probability) {
    DirectionalLight light = directional_lights.at[index];
    vec3 direction = sample_cone(light.direction_to_light, light.one_minus_cos_half_angle, u);
    return ResolvedLightSample(
        LIGHT_DIRECTIONAL, 0u, direction, -direction, 0.0, light.radiance, inverse_probability * light.solid_angle
    );
}

float emission_cosine_directional(uint data, float cosine) { return max(cosine, 0.0); }

uint debug_color_id_directional(uint index) { return ~index; }

LightHit evaluate_directional(uint index, vec3 direction) {
    DirectionalLight light = directional_lights.at[index];
    // |a - b|^2 / 2 = 1 - cos is without the cancellation of 1 - dot(a, b) for nearly equal directions
    vec3 difference = direction - light.direction_to_light;
    float one_minus_cos = 0.5 * dot(difference, difference);
    if (one_minus_cos > light.one_minus_cos_half_angle) { return NO_LIGHT_HIT; }
    vec2 u = invert_cone_sample(light.direction_to_light, light.one_minus_cos_half_angle, direction, one_minus_cos);
    return LightHit(light.radiance, light.solid_angle, 0u, u, INFINITY);
}

#endif
