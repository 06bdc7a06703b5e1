// Shadow rays to light samples, and what lets light pass from lights that rays meet on their way.
#ifndef SCENE_LIGHT_VISIBILITY_GLSL
#define SCENE_LIGHT_VISIBILITY_GLSL

#include "scene/sampling.glsl"
#include "scene/trace.glsl"

// From a ray origin, already offset from its surface, to just before the light's point.
vec3 light_segment(vec3 ray_origin, ResolvedLightSample light_sample) {
    light_sample = aim_light(light_sample, ray_origin);
    vec3 to_light = light_sample.world_position - ray_origin;
    // ends before the light by the rounding error of the light's point and of a ray of this length
    float offset = light_sample.ray_offset + 16.0 * ROUNDING_UNIT * max_component(abs(to_light));
    return to_light - light_sample.world_normal * (dot(to_light, light_sample.world_normal) < 0.0 ? -offset : offset);
}

// The share of a light sample's light that reaches a ray origin, which is already offset from its surface.
vec3 trace_light_transmittance(vec3 ray_origin, ResolvedLightSample light_sample) {
    bool at_infinity = is_at_infinity(light_sample.kind);
    vec3 segment = at_infinity ? light_sample.world_position : light_segment(ray_origin, light_sample);
    return trace_transmittance(ray_origin, segment, at_infinity ? INFINITY : 1.0);
}

// As radiance_passed, with the light of each lamp tinted by what the ray passes on its way to it. `rays` is the number
// of rays that this takes.
vec3 trace_radiance_passed(vec3 origin, vec3 direction, float t_max, float bounce_pdf, out uint rays) {
    rays = 0u;
    if (!SCENE_BLEND) { return radiance_passed(origin, direction, t_max, bounce_pdf); }
    vec3 radiance = vec3(0.0);
    for (uint i = scene_info.first_passed_light; SCENE_SPHERE && i < scene_info.first_light_at_infinity; i++) {
        LightSource light = light_sources.at[i];
        MetLight met = pass_light(light.kind, light.index, origin, direction, t_max);
        vec3 received = met_radiance(met, light.choice.probability, bounce_pdf);
        if (received == vec3(0.0)) { continue; }
        rays += 1u;
        radiance += received * trace_passage(origin, direction, met.t, NO_HIT).tint;
    }
    return radiance;
}

#endif
