// Portals: openings through which environments light a room. Each receiver takes places of a portal by the light that
// it sees through them. Directions through a portal are sampled by the portal, by others behind or before it, and by
// the environment's own samples; each of these stands for a share of the light, by the balance heuristic where all are
// chosen by power: Veach, "Robust Monte Carlo Methods for Light Transport Simulation" (1997), chapter 9. The shares of
// a direction add up to 1, so no light is lost or counted twice, wherever portals are.
#ifndef SCENE_LIGHTS_PORTAL_GLSL
#define SCENE_LIGHTS_PORTAL_GLSL

#include "scene/lights/environment.glsl"
#include "scene/lights/openings.glsl"
#include "scene/lights/types.glsl"

// `world_position` holds the random numbers until a receiver is known.
ResolvedLightSample resolve_portal(uint index, uint part, vec2 u, float inverse_probability) {
    return ResolvedLightSample(
        LIGHT_PORTAL, index, vec3(u, 0.0), portals.at[index].normal, 0.0, vec3(1.0), inverse_probability
    );
}

ResolvedLightSample sample_for_receiver_portal(ResolvedLightSample light_sample, vec3 receiver) {
    uint index = light_sample.data;
    Portal portal = portals.at[index];
    Outlook seen = look_through(portal, receiver);
    vec2 u = light_sample.world_position.xy;
    light_sample.world_position = portal.normal;
    light_sample.radiance = vec3(0.0);
    if (seen.weight == 0u) { return light_sample; }
    float density_by_area;
    vec2 place = sample_place(portal, seen, u, density_by_area);
    vec3 to_place = portal.corner + place.x * portal.side_u + place.y * portal.side_v - receiver;
    vec3 direction = safe_normalize(to_place, portal.normal);
    float density = density_by_area * dot(to_place, to_place) / max(abs(dot(direction, portal.normal)), 1e-30);
    light_sample.world_position = direction;
    light_sample.world_normal = -direction;
    float own = density * light_probability_by_power(light_sources.at[portal_light(index)]);
    if (!(own > 0.0 && own < INFINITY)) { return light_sample; }
    light_sample.inverse_area_pdf /= density;
    float all = own + pdf_of_openings(receiver, direction, index);
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_end; i++) {
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
