// Portals: openings through which environments light a room. A light sample is a point of the portal, uniform over its
// area; a receiver sees the environment behind it. Directions through a portal are sampled by the portal, by others
// behind or before it, and by the environment's own samples; each of these stands for a share of the light, by the
// balance heuristic where all are chosen by power: Veach, "Robust Monte Carlo Methods for Light Transport Simulation"
// (1997), chapter 9. The shares of a direction add up to 1, so no light is lost or counted twice, wherever portals are.
#ifndef SCENE_LIGHTS_PORTAL_GLSL
#define SCENE_LIGHTS_PORTAL_GLSL

#include "scene/lights/environment.glsl"
#include "scene/lights/openings.glsl"
#include "scene/lights/types.glsl"

const float MIN_PORTAL_SOLID_ANGLE = 1e-20;  // below it a receiver sees nothing of a portal

ResolvedLightSample resolve_portal(uint index, uint part, vec2 u, float inverse_probability) {
    Portal portal = portals.at[index];
    vec3 place = portal.corner + u.x * portal.side_u + u.y * portal.side_v;
    return ResolvedLightSample(
        LIGHT_PORTAL, index, place, portal.normal, 0.0, vec3(1.0), inverse_probability * portal.area
    );
}

ResolvedLightSample sample_for_receiver_portal(ResolvedLightSample light_sample, vec3 receiver) {
    uint index = light_sample.data;
    Portal portal = portals.at[index];
    vec3 to_place = light_sample.world_position - receiver;
    vec3 direction = safe_normalize(to_place, portal.normal);
    float solid_angle_per_area = abs(dot(direction, portal.normal)) / max(dot(to_place, to_place), 1e-30);
    light_sample.world_position = direction;
    light_sample.world_normal = -direction;
    light_sample.inverse_area_pdf *= solid_angle_per_area;
    light_sample.radiance = vec3(0.0);
    float solid_angle = solid_angle_per_area * portal.area;
    if (!(solid_angle > MIN_PORTAL_SOLID_ANGLE)) { return light_sample; }
    float own = light_probability_by_power(light_sources.at[scene_info.first_portal + index]) / solid_angle;
    if (!(own > 0.0)) { return light_sample; }
    float all = own + density_of_openings(receiver, direction, index);
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_count; i++) {
        LightSource light = light_sources.at[i];
        if (!SCENE_ENVIRONMENT || light.kind != LIGHT_ENVIRONMENT) { continue; }
        LightHit light_hit = evaluate_environment(light.record_index, direction);
        if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { continue; }
        float of_map = light_probability_by_power(light) / light_hit.inverse_solid_angle_pdf;
        light_sample.radiance += light_hit.radiance * (own / (of_map + all));
    }
    return light_sample;
}

float emission_cosine_portal(uint index, float cosine) { return 1.0; }

uint debug_color_id_portal(uint index) { return 0xE0000000u + index; }

#endif
