// Thread indices of the world cache's passes, which are dispatched in rows to stay below the limit on workgroup counts.
#ifndef PASSES_WORLD_CACHE_THREADS_GLSL
#define PASSES_WORLD_CACHE_THREADS_GLSL

#include "generated/passes/world_cache.glsl"
#include "passes/world_cache/map.glsl"

uint thread_index(uvec2 invocation_index) {
    return invocation_index.y * (ROW_GROUPS * GROUP_SIZE) + invocation_index.x;
}

#endif
