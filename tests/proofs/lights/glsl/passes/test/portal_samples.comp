// Draws light samples of portals for one receiver, and evaluates their density in random directions through the cells
// of a grid over each portal.
#version 460
#include "common/random.glsl"
#include "scene/sampling.glsl"

layout(local_size_x = 64) in;

const uint GRID = 256u;

struct Drawn {
    uint portal;
    vec3 direction;
    float pdf;      // of the sample in solid angle, by the sample
    float density;  // the same for this direction
    vec2 u, inverted;
};

layout(set = 1, scalar) readonly buffer PlaceBlock { vec3 receiver[]; } place;
layout(set = 1, scalar) buffer DrawnBlock { Drawn at[]; } drawn;
// The density of a direction times the solid angle of its cell.
layout(set = 1, scalar) buffer ChancesBlock { float at[]; } chances;

void main() {
    uint i = gl_GlobalInvocationID.x;
    vec3 receiver = place.receiver[0];
    if (i < drawn.at.length()) {
        uint rng = seed_rng(uvec2(i, 9u), 0u, 5u);
        uint index = rand_range_u(portal_end(), rng);
        vec2 u = rand_vec2f(rng);
        float probability = light_probability_by_power(light_sources.at[portal_light(index)]);
        ResolvedLightSample found = resolve_light(LIGHT_PORTAL, index, 0u, u, 1.0 / probability);
        found = light_sample_for_receiver(found, receiver);
        drawn.at[i] = Drawn(
            index, found.world_position, 1.0 / found.inverse_area_pdf,
            evaluate_portal_pdf(index, receiver, found.world_position), u,
            invert_portal_sample(index, receiver, found.world_position)
        );
    }
    if (i < chances.at.length()) {
        Portal portal = portals.at[i / (GRID * GRID)];
        uint rng = seed_rng(uvec2(i, 2u), 0u, 3u);
        vec2 at = (vec2(i % GRID, i / GRID % GRID) + rand_vec2f(rng)) / float(GRID);
        vec3 to_place = portal.corner + at.x * portal.side_u + at.y * portal.side_v - receiver;
        vec3 direction = normalize(to_place);
        float solid_angle = portal.area * abs(dot(direction, portal.normal)) / dot(to_place, to_place);
        chances.at[i] =
            evaluate_portal_pdf(i / (GRID * GRID), receiver, direction) * solid_angle / float(GRID * GRID);
    }
}
