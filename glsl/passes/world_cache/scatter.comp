// World cache, step 4: the list of active cells, in the map's order.
#version 460
#include "passes/world_cache/compaction.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint thread = thread_index(gl_GlobalInvocationID.xy);
    uint total;
    uint at = world_cache_blocks.at[thread / GROUP_SIZE] + sum_before(count_active_cells(thread), total);
    for (uint i = 0u; i < CELLS_PER_THREAD; i++) {
        uint cell = thread * CELLS_PER_THREAD + i;
        if (world_cache_checksums.at[cell] != EMPTY_CELL) { world_cache_active_cells.at[at++] = cell; }
    }
}
