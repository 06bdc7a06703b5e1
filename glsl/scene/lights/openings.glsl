// The openings of portals: with which density points of them are chosen.
#ifndef SCENE_LIGHTS_OPENINGS_GLSL
#define SCENE_LIGHTS_OPENINGS_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/choice.glsl"

struct Portal {
    vec3 corner;
    vec3 side_u, side_v;
    vec3 across_u, across_v;  // their dot products with a place, from the corner, are its coordinates along the sides
    vec3 normal;
    float area;
};

layout(set = 0, scalar) readonly buffer PortalsBlock {
    Portal at[];
} portals;

// Where a ray passes a portal.
struct Opening {
    // In solid angle, with which light samples take the direction by this portal, where they choose it by power; 0: the
    // ray doesn't pass it.
    float density;
    vec2 u;  // the random numbers of the place
};

Opening find_opening(uint index, vec3 origin, vec3 direction) {
    Portal portal = portals.at[index];
    float cosine = dot(direction, portal.normal);
    float t = dot(portal.corner - origin, portal.normal) / cosine;
    vec3 place = origin + t * direction - portal.corner;
    vec2 u = vec2(dot(place, portal.across_u), dot(place, portal.across_v));
    bool passes = t > 0.0 && t < INFINITY && u == clamp(u, 0.0, 1.0);
    float probability = light_probability_by_power(light_sources.at[scene_info.first_portal + index]);
    return Opening(passes ? probability * square(t) / (portal.area * abs(cosine)) : 0.0, u);
}

uint portal_count() { return scene_info.first_pass_through_light - scene_info.first_portal; }

// The sum of the densities of all portals but one; NO_INDEX: of all.
float density_of_openings(vec3 origin, vec3 direction, uint left_out) {
    float density = 0.0;
    for (uint i = 0u; i < portal_count(); i++) {
        if (i != left_out) { density += find_opening(i, origin, direction).density; }
    }
    return density;
}

#endif
