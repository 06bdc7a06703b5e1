// Counts rays by pass, in pipelines built for it.
#ifndef PASSES_RAY_COUNT_GLSL
#define PASSES_RAY_COUNT_GLSL

#include "passes/bindings.glsl"

layout(constant_id = 3) const bool count_rays = false;

// Rows of ray_counts, which grow from frame to frame (modulo 2^32).
const uint RAYS_OF_GBUFFER = 0u;
const uint RAYS_OF_WORLD_CACHE = 1u;
const uint RAYS_OF_DI = 2u;
const uint RAYS_OF_GI = 3u;
const uint RAYS_OF_SPECULAR_GI = 4u;
const uint RAYS_OF_GUIDES = 5u;

void count_ray(uint pass_index) {
    if (count_rays) { atomicAdd(ray_counts.at[pass_index], 1u); }
}

#endif
