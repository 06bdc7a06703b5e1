// World cache, step 3: how many cells are active before every block, and in all; one workgroup does it.
#version 460
#include "passes/world_cache/compaction.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint block_count = world_cache_checksums.at.length() / (GROUP_SIZE * CELLS_PER_THREAD);
    uint blocks_per_thread = (block_count + GROUP_SIZE - 1u) / GROUP_SIZE;
    uint first = min(gl_LocalInvocationIndex * blocks_per_thread, block_count);
    uint end = min(first + blocks_per_thread, block_count);

    uint sum = 0u, total;
    for (uint i = first; i < end; i++) { sum += world_cache_blocks.at[i]; }
    uint before = sum_before(sum, total);
    for (uint i = first; i < end; i++) {
        uint count = world_cache_blocks.at[i];
        world_cache_blocks.at[i] = before;
        before += count;
    }

    if (gl_LocalInvocationIndex == 0u) {
        world_cache_counters.active_cells = total;
        uint groups = (total + GROUP_SIZE - 1u) / GROUP_SIZE;
        world_cache_dispatch.group_count = uvec3(min(groups, ROW_GROUPS), (groups + ROW_GROUPS - 1u) / ROW_GROUPS, 1u);
    }
}
