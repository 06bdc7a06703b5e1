// Counts the rays of a pass, in pipelines whose constant ray_counter is set.
#ifndef PASSES_RAY_COUNT_GLSL
#define PASSES_RAY_COUNT_GLSL

#include "passes/bindings.glsl"

const uint NOT_COUNTED = 0xFFFFFFFFu;
layout(constant_id = ray_counter_id) const uint ray_counter = NOT_COUNTED;  // row of ray_counts; counts are modulo 2^32

void count_rays(uint count) {
    if (ray_counter != NOT_COUNTED && count > 0u) { atomicAdd(ray_counts.at[ray_counter], count); }
}

void count_ray() { count_rays(1u); }

#endif
