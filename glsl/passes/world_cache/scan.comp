// World cache, step 2: where each block's active cells begin in the list of active cells, and their number, by a prefix
// sum in one workgroup: Hillis and Steele, "Data Parallel Algorithms" (1986). Each thread sums consecutive blocks.
#version 460
#include "generated/passes/world_cache.glsl"  // BLOCK_SIZE, written by solari_vk/passes/world_cache.py
#include "passes/world_cache/map.glsl"

const uint SCAN_SIZE = 256u;
const uint BATCH = 8u;  // blocks that a thread reads at once, so that it seldom waits for memory
layout(local_size_x = SCAN_SIZE) in;

layout(constant_id = fill_rounds_id) const uint fill_rounds = 0u;

shared uint sums[SCAN_SIZE];

uint[BATCH] read_counts(uint first, uint end) {
    uint counts[BATCH];
    for (uint i = 0u; i < BATCH; i++) { counts[i] = first + i < end ? world_cache_blocks.at[first + i] : 0u; }
    return counts;
}

void main() {
    uint thread = gl_LocalInvocationIndex;
    uint block_count = world_cache_checksums.at.length() / BLOCK_SIZE;
    uint begin = thread * block_count / SCAN_SIZE, end = (thread + 1u) * block_count / SCAN_SIZE;
    uint sum = 0u;
    for (uint first = begin; first < end; first += BATCH) {
        uint counts[BATCH] = read_counts(first, end);
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
    for (uint first = begin; first < end; first += BATCH) {
        uint counts[BATCH] = read_counts(first, end);
        for (uint i = 0u; i < BATCH && first + i < end; i++) {
            world_cache_blocks.at[first + i] = before;
            before += counts[i];
        }
    }

    if (thread == SCAN_SIZE - 1u) {
        uint total = sums[thread];
        world_cache_counters.active_cells = total;
        world_cache_dispatch.old_cells = total;
        world_cache_dispatch.first_cell = world_cache_dispatch.misses = 0u;
        world_cache_dispatch.rounds_left = fill_rounds > 0u ? fill_rounds + 1u : 0u;  // begin_round takes one away
        world_cache_dispatch.size = make_indirect_dispatch(total, 1u);
    }
}
