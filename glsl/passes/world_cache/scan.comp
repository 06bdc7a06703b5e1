// World cache, step 2: where each block's active cells begin in the list of active cells, and their number, by a prefix
// sum in one workgroup: Hillis and Steele, "Data Parallel Algorithms" (1986). Each thread sums every SCAN_SIZE-th
// block, so that neighboring threads read neighboring memory. The list is therefore in the order of threads, not of
// blocks.
#version 460
#include "generated/passes/world_cache.glsl"
#include "passes/world_cache/map.glsl"

const uint SCAN_SIZE = 256u;
const uint BATCH = 8u;  // blocks that a thread reads at once, so that it seldom waits for memory
layout(local_size_x = SCAN_SIZE) in;

shared uint sums[SCAN_SIZE];

uint[BATCH] read_counts(uint first, uint block_count) {
    uint counts[BATCH];
    for (uint i = 0u; i < BATCH; i++) {
        uint block = first + i * SCAN_SIZE;
        counts[i] = block < block_count ? world_cache_blocks.at[block] : 0u;
    }
    return counts;
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint block_count = world_cache_checksums.at.length() / BLOCK_SIZE;
    uint sum = 0u;
    for (uint first = thread; first < block_count; first += BATCH * SCAN_SIZE) {
        uint counts[BATCH] = read_counts(first, block_count);
        for (uint i = 0u; i < BATCH; i++) { sum += counts[i]; }
    }
    sums[thread] = sum;
    for (uint reach = 1u; reach < SCAN_SIZE; reach *= 2u) {
        barrier();
        uint before = thread >= reach ? sums[thread - reach] : 0u;
        barrier();
        sums[thread] += before;
    }
    uint before = sums[thread] - sum;
    for (uint first = thread; first < block_count; first += BATCH * SCAN_SIZE) {
        uint counts[BATCH] = read_counts(first, block_count);
        for (uint i = 0u; i < BATCH && first + i * SCAN_SIZE < block_count; i++) {
            world_cache_blocks.at[first + i * SCAN_SIZE] = before;
            before += counts[i];
        }
    }

    if (thread == SCAN_SIZE - 1u) {
        uint total = sums[thread];
        world_cache_counters.active_cells = total;
        world_cache_dispatch.size = make_indirect_dispatch(total);
    }
}
