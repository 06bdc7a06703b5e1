// World cache, step 2: the number of active cells before each block and in total, by a prefix sum in one workgroup:
// Hillis and Steele, "Data Parallel Algorithms" (1986).
#version 460
#include "passes/world_cache/threads.glsl"

const uint SCAN_SIZE = 256u;
layout(local_size_x = SCAN_SIZE) in;

shared uint sums[SCAN_SIZE];

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint block_count = world_cache_checksums.at.length() / BLOCK_SIZE;
    uint blocks_each = (block_count + SCAN_SIZE - 1u) / SCAN_SIZE;
    uint first = min(thread * blocks_each, block_count);
    uint end = min(first + blocks_each, block_count);

    uint sum = 0u;
    for (uint i = first; i < end; i++) { sum += world_cache_blocks.at[i]; }
    sums[thread] = sum;
    for (uint reach = 1u; reach < SCAN_SIZE; reach *= 2u) {
        barrier();
        uint before = thread >= reach ? sums[thread - reach] : 0u;
        barrier();
        sums[thread] += before;
    }
    uint before = sums[thread] - sum;
    for (uint i = first; i < end; i++) {
        uint count = world_cache_blocks.at[i];
        world_cache_blocks.at[i] = before;
        before += count;
    }

    if (thread == SCAN_SIZE - 1u) {
        uint total = sums[thread];
        world_cache_counters.active_cells = total;
        uint groups = (total + GROUP_SIZE - 1u) / GROUP_SIZE;
        uvec3 group_count = uvec3(min(groups, ROW_GROUPS), (groups + ROW_GROUPS - 1u) / ROW_GROUPS, 1u);
        world_cache_dispatch.group_count = group_count;
        world_cache_dispatch.thread_count = group_count * uvec3(GROUP_SIZE, 1u, 1u);
    }
}
