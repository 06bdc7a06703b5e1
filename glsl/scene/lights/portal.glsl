// Portals: openings through which environments light a room. Each receiver samples points of a portal by the light that
// it sees through them. Several sampling strategies can take the same direction to the environment: its own map, this
// portal, and other portals behind or before this one. The radiance is split among them: each strategy's samples carry
// its weight by the balance heuristic (Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997,
// chapter 9), with pdfs as if all lights were chosen by power. These weights add up to 1, so that no light is lost or
// counted twice, wherever portals are, and for any probabilities with which lights are really chosen.
#ifndef SCENE_LIGHTS_PORTAL_GLSL
#define SCENE_LIGHTS_PORTAL_GLSL

#include "scene/lights/environment.glsl"
#include "scene/lights/portal_sampling.glsl"
#include "scene/lights/types.glsl"

// `world_position` holds the random numbers until sample_for_receiver_portal makes a direction of them.
ResolvedLightSample resolve_portal(uint index, uint part, vec2 u, float inverse_probability) {
    return ResolvedLightSample(
        LIGHT_PORTAL, index, vec3(u, 0.0), portals.at[index].normal, 0.0, vec3(1.0), inverse_probability
    );
}

ResolvedLightSample sample_for_receiver_portal(ResolvedLightSample light_sample, vec3 receiver) {
    uint index = light_sample.data;
    Portal portal = portals.at[index];
    MapWindow window = find_window(portal, receiver);
    vec2 u = light_sample.world_position.xy;
    light_sample.world_position = portal.normal;
    light_sample.radiance = vec3(0.0);
    if (window.weight_sum == 0u) { return light_sample; }
    float area_pdf;
    vec2 uv = sample_window(portal, window, u, area_pdf);
    vec3 to_point = portal.corner + uv.x * portal.side_u + uv.y * portal.side_v - receiver;
    vec3 direction = safe_normalize(to_point, portal.normal);
    float solid_angle_pdf = area_pdf * dot(to_point, to_point) / max(abs(dot(direction, portal.normal)), 1e-30);
    light_sample.world_position = direction;
    light_sample.world_normal = -direction;
    float portal_pdf = solid_angle_pdf * light_probability_by_power(light_sources.at[portal_light(index)]);
    if (!(portal_pdf > 0.0 && portal_pdf < INFINITY)) { return light_sample; }
    light_sample.inverse_area_pdf /= solid_angle_pdf;
    float pdf_sum = portal_pdf + sum_portal_pdfs(receiver, direction, index);
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_end; i++) {
        LightSource light = light_sources.at[i];
        if (!SCENE_ENVIRONMENT || light.kind != LIGHT_ENVIRONMENT) { continue; }
        LightHit light_hit = evaluate_environment(light.record_index, direction);
        if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { continue; }
        float map_pdf = light_probability_by_power(light) / light_hit.inverse_solid_angle_pdf;
        light_sample.radiance += light_hit.radiance * (portal_pdf / (map_pdf + pdf_sum));
    }
    return light_sample;
}

float emission_cosine_portal(uint index, float cosine) { return 1.0; }

uint debug_color_id_portal(uint index) { return 0xE0000000u + index; }

#endif
