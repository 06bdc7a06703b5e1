// The one-dimensional dispatches of the world cache, in rows that no device's limit on workgroups cuts short.
#ifndef PASSES_WORLD_CACHE_THREADS_GLSL
#define PASSES_WORLD_CACHE_THREADS_GLSL

#include "passes/world_cache/map.glsl"

const uint GROUP_SIZE = 64u;
const uint ROW_GROUPS = 1024u;
const uint BLOCK_SIZE = 16u;  // cells in a row that one thread of a pass over the whole map looks after

uint thread_index(uvec2 invocation_index) {
    return invocation_index.y * (ROW_GROUPS * GROUP_SIZE) + invocation_index.x;
}

#endif
