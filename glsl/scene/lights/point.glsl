// Lights at a point, which no ray can hit.
#ifndef SCENE_LIGHTS_POINT_GLSL
#define SCENE_LIGHTS_POINT_GLSL

#include "scene/bindings.glsl"
#include "scene/lights/punctual.glsl"
#include "scene/lights/types.glsl"

layout(set = 0, scalar) readonly buffer PointLightsBlock {
    PunctualLight at[];
} point_lights;

const float MIN_POINT_DISTANCE = 1e-4;  // meters; irradiance is no larger at surfaces nearer than this

ResolvedLightSample resolve_point(uint index, uint part, vec2 u, float inverse_probability) {
    PunctualLight light = point_lights.at[index];
    return ResolvedLightSample(
        LIGHT_POINT, index, light.position, light.axis, 0.0, light.strength, inverse_probability
    );
}

ResolvedLightSample sample_for_receiver_point(ResolvedLightSample light_sample, vec3 receiver) {
    PunctualLight light = point_lights.at[light_sample.data];
    vec3 to_receiver = receiver - light.position;
    float distance = length(to_receiver);
    light_sample.world_normal = safe_normalize(to_receiver, light.axis);
    light_sample.radiance *= punctual_falloff(light, light_sample.world_normal, distance)
        * square(min(distance / MIN_POINT_DISTANCE, 1.0));
    return light_sample;
}

float emission_cosine_point(uint index, float cosine) { return 1.0; }

uint debug_color_id_point(uint index) { return 0x80000000u + index; }

#endif
