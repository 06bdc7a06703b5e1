// Queries the world cache as pixels do, at the ends of rays: each first ray starts at the camera in a uniform random
// direction, and the second ray leaves the surface that the first one hits.
#version 460
#include "passes/world_cache/query.glsl"

layout(set = 1, scalar) buffer AnswersBlock { vec3 at[]; } answers;

layout(local_size_x = 64) in;

// 0: query at the end of the second ray; 1: at the end of the first.
layout(constant_id = first_ray_id) const uint first_ray = 0u;

void main() {
    uint index = INVOCATION_INDEX.x;
    if (index >= answers.at.length() || solari019_settings.gi == 0u) { return; }
    uint rng = seed_rng(uvec2(index, 1u), this_frame.index, this_frame.seed);
    float z = 2.0 * rand_f(rng) - 1.0, angle = 2.0 * PI * rand_f(rng);
    vec3 direction = vec3(sqrt(1.0 - z * z) * vec2(cos(angle), sin(angle)), z);
    vec3 origin = camera.world_from_view[3];
    answers.at[index] = vec3(0.0);
    if (first_ray == 0u) {
        Hit hit = trace_closest_hit(origin, 0.0, direction, INFINITY, TRACE_BOTH_FACES);
        if (hit.instance == NO_INDEX) { return; }
        SurfaceInteraction surface = resolve_surface_interaction(hit, direction, 0.0);
        origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
        direction = orthonormalize(surface.geometric_world_normal) * sample_cosine_hemisphere(rand_vec2f(rng));
    }
    uint lifetime = world_cache_settings.lifetime;
    answers.at[index] = gathered_radiance(gather_light(start_walk(origin, direction), true, lifetime, rng));
}
