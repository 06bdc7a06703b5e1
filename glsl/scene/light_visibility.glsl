// Shadow rays to light samples.
#ifndef SCENE_LIGHT_VISIBILITY_GLSL
#define SCENE_LIGHT_VISIBILITY_GLSL

#include "scene/sampling.glsl"
#include "scene/trace.glsl"

// The vector from a ray origin, already offset from its surface, to just before the light's point; for a light at
// infinity, the direction to it. `light_sample`: what light_sample_for_receiver or shadow_sample_for_receiver has
// returned for this origin.
vec3 segment_to_light(vec3 ray_origin, ResolvedLightSample light_sample) {
    if (is_at_infinity(light_sample.kind)) { return light_sample.world_position; }
    vec3 to_light = light_sample.world_position - ray_origin;
    // ends before the light by the rounding error of the light's point and of a ray of this length
    float offset = light_sample.ray_offset + 16.0 * ROUNDING_UNIT * max_component(abs(to_light));
    return to_light - light_sample.world_normal * (dot(to_light, light_sample.world_normal) < 0.0 ? -offset : offset);
}

vec3 shadow_ray_segment(vec3 ray_origin, ResolvedLightSample light_sample) {
    return segment_to_light(ray_origin, light_sample_for_receiver(light_sample, ray_origin));
}

// The transmittance of surfaces between a light sample and a ray origin, which is already offset from its surface.
// `light_sample`: shadow_sample_for_receiver of what for_shadow_ray has returned.
vec3 trace_light_transmittance(vec3 ray_origin, ResolvedLightSample light_sample) {
    vec3 segment = segment_to_light(ray_origin, light_sample);
    return trace_transmittance(ray_origin, segment, is_at_infinity(light_sample.kind) ? INFINITY : 1.0);
}

// The same for what for_shadow_ray has returned.
vec3 trace_shadow_ray(vec3 ray_origin, ResolvedLightSample light_sample) {
    return trace_light_transmittance(ray_origin, shadow_sample_for_receiver(light_sample, ray_origin));
}

#endif
