// Traces rays from a user's arrays: the closest hit of each, or any hit, with the user's own number of the triangle. A
// ray with NaN, an infinite origin or direction, or a zero direction hits nothing. With BACKSCATTER rays meet every
// surface, however little of it is opaque, and say how it scatters them back.
#ifndef PASSES_RAY_TRACER_TRACE_GLSL
#define PASSES_RAY_TRACER_TRACE_GLSL

#extension GL_EXT_scalar_block_layout : require
#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"
#ifdef BACKSCATTER
#include "passes/ray_tracer/backscatter.glsl"
#endif

layout(constant_id = any_hit_id) const bool any_hit = false;

struct TracedHit {
    float t;
    uint instance;
    uint primitive;
    vec2 barycentrics;
    uint front_face;
    vec3 position;
    vec3 normal;
};

layout(set = 1, scalar) uniform RayBatchBlock {
    uint first;  // index of the batch's first ray in the buffers
    uint count;
    uint number;  // of the batch's first ray among all of the user's
    uint seed;
} ray_batch;
layout(set = 1, scalar) readonly buffer RayOriginsBlock { vec3 at[]; } ray_origins;
layout(set = 1, scalar) readonly buffer RayDirectionsBlock { vec3 at[]; } ray_directions;
layout(set = 1, scalar) readonly buffer RayStartsBlock { float at[]; } ray_starts;
layout(set = 1, scalar) readonly buffer RayEndsBlock { float at[]; } ray_ends;
layout(set = 1, scalar) writeonly buffer RayHitsBlock { TracedHit at[]; } ray_hits;
// The user's number of each triangle in the device's order, and the index of each mesh's first triangle in it.
layout(set = 1, scalar) readonly buffer TriangleOrdersBlock { uint at[]; } triangle_orders;
layout(set = 1, scalar) readonly buffer OrderStartsBlock { uint at[]; } order_starts;

bool is_finite(vec3 v) { return all(lessThanEqual(abs(v), vec3(3.4028235e38))); }  // comparisons with NaN are false

void trace_rays() {
    if (INVOCATION_INDEX.x >= ray_batch.count) { return; }
    uint i = ray_batch.first + INVOCATION_INDEX.x;
    vec3 origin = ray_origins.at[i], direction = ray_directions.at[i];
    float t_min = ray_starts.at[i], t_max = ray_ends.at[i];
    bool valid = is_finite(origin) && is_finite(direction) && any(notEqual(direction, vec3(0.0)));
    valid = valid && t_min >= 0.0 && t_min <= t_max;

    Hit hit = Hit(INFINITY, NO_INDEX, 0u, vec2(0.0), false);
    uint flags = any_hit ? TRACE_ANY_HIT : TRACE_BOTH_FACES;
#ifdef BACKSCATTER
    uvec2 alpha_seed = EVERY_SURFACE;
#else
    uint rng = seed_rng(uvec2(ray_batch.number + INVOCATION_INDEX.x, 0u), 0u, ray_batch.seed);
    uvec2 alpha_seed = random_alpha_seed(rng);
#endif
    if (valid) { hit = trace_closest_hit(origin, t_min, direction, t_max, flags, alpha_seed); }
    // A single write: two of them cost a software device 5 % of its rays a second.
    TracedHit traced = TracedHit(INFINITY, NO_INDEX, NO_INDEX, vec2(0.0), 0u, vec3(0.0), vec3(0.0));
    if (hit.instance != NO_INDEX) {
        Instance instance = instances.at[hit.instance];
        TrianglePoint point = resolve_triangle(instance, meshes.at[instance.ray_mesh], hit.triangle, hit.barycentrics);
        vec3 position = position_on_ray(
            point.world_position, point.geometric_world_normal, point.extent, origin, hit.t * direction
        );
        traced = TracedHit(
            hit.t, hit.instance, triangle_orders.at[order_starts.at[instance.ray_mesh] + hit.triangle],
            hit.barycentrics, uint(hit.front_face), position + scene_info.origin, point.geometric_world_normal
        );
    }
    ray_hits.at[i] = traced;
#ifdef BACKSCATTER
    ray_echoes.at[i] = hit.instance == NO_INDEX ? NO_ECHO
        : find_echo(hit, origin + t_min * direction, (hit.t - t_min) * direction);
#endif
}

#endif
