// World cache, step 2: how many cells of every block are active.
#version 460
#include "passes/world_cache/compaction.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint thread = thread_index(gl_GlobalInvocationID.xy);
    uint total;
    sum_before(count_active_cells(thread), total);
    if (gl_LocalInvocationIndex == 0u) { world_cache_blocks.at[thread / GROUP_SIZE] = total; }
}
