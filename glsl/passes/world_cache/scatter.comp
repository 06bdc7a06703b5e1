// World cache, step 3: writes the list of active cells, block by block, with their lives, which later passes both read
// and raise.
#version 460
#include "generated/passes/world_cache.glsl"  // BLOCK_SIZE, written by solari_vk/passes/world_cache.py
#include "passes/world_cache/map.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint block = thread_index(gl_GlobalInvocationID.xy);
    uint next = world_cache_blocks.at[block];
    for (uint cell = block * BLOCK_SIZE; cell < (block + 1u) * BLOCK_SIZE; cell++) {
        if (!is_to_update(cell)) { continue; }
        world_cache_active_cells.at[next] = cell;
        world_cache_samples.at[next++].life = world_cache_life.at[cell];
    }
}
