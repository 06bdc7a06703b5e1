// Whether a point of a light is seen.
#ifndef SCENE_LIGHT_VISIBILITY_GLSL
#define SCENE_LIGHT_VISIBILITY_GLSL

#include "scene/sampling.glsl"
#include "scene/trace.glsl"

// From a point that was moved off its surface already to just before a light's point.
vec3 light_segment(vec3 ray_origin, ResolvedLightSample light_sample) {
    vec3 to_light = light_sample.world_position.xyz - ray_origin;
    // the far end stops short of the light by its own error and by what rounding makes of a ray this long
    float offset = light_sample.ray_offset + 16.0 * ROUNDING_UNIT * max_component(abs(to_light));
    return to_light - light_sample.world_normal * (dot(to_light, light_sample.world_normal) < 0.0 ? -offset : offset);
}

// Whether a light sample is seen from a point that was moved off its surface already.
bool trace_light_visibility(vec3 ray_origin, ResolvedLightSample light_sample) {
    bool directional = light_sample.world_position.w == 0.0;
    vec3 segment = directional ? light_sample.world_position.xyz : light_segment(ray_origin, light_sample);
    return trace_visibility(ray_origin, segment, directional ? INFINITY : 1.0);
}

#endif
