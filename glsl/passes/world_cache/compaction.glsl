// What the compaction's steps share: which cells a thread looks after, and sums over a workgroup.
#ifndef PASSES_WORLD_CACHE_COMPACTION_GLSL
#define PASSES_WORLD_CACHE_COMPACTION_GLSL

#include "passes/world_cache/threads.glsl"

const uint CELLS_PER_THREAD = 16u;  // 1024 to a workgroup; the map's size is a multiple of that

uint count_active_cells(uint thread) {
    uint count = 0u;
    for (uint i = 0u; i < CELLS_PER_THREAD; i++) {
        count += world_cache_checksums.at[thread * CELLS_PER_THREAD + i] != EMPTY_CELL ? 1u : 0u;
    }
    return count;
}

shared uint sums[GROUP_SIZE];

// The sum of the values of the workgroup's threads before this one: Hillis and Steele, "Data Parallel Algorithms" (1986).
uint sum_before(uint value, out uint total) {
    uint thread = gl_LocalInvocationIndex;
    sums[thread] = value;
    for (uint reach = 1u; reach < GROUP_SIZE; reach *= 2u) {
        barrier();
        uint before = thread >= reach ? sums[thread - reach] : 0u;
        barrier();
        sums[thread] += before;
    }
    barrier();
    total = sums[GROUP_SIZE - 1u];
    return sums[thread] - value;
}

#endif
