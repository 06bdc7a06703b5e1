// World cache, step 1: cells that nobody asked for in their lifetime die; for the others, one of the last frame's askers is
// chosen to stand for the cell.
#version 460
#include "passes/world_cache/threads.glsl"

layout(local_size_x = GROUP_SIZE) in;

void clear_cell(uint cell) {
    world_cache_checksums.at[cell] = EMPTY_CELL;
    world_cache_life.at[cell] = 0u;
    world_cache_irradiance.at[cell] = vec4(0.0);
    world_cache_luminance_deltas.at[cell] = 0.0;
    world_cache_votes.at[cell] = WorldCachePoint(0u, 0u);
}

void main() {
    uint cell = thread_index(gl_GlobalInvocationID.xy);
    if (cell == 0u) {
        world_cache_counters.updates = 0u;
        world_cache_counters.insert_failures = 0u;
    }
    if (uniforms.has_history == 0u) {
        clear_cell(cell);
        return;
    }
    if (world_cache_checksums.at[cell] == EMPTY_CELL) { return; }
    uint life = world_cache_life.at[cell];
    if (life == 0u) {
        clear_cell(cell);
        return;
    }
    world_cache_life.at[cell] = life - 1u;
    WorldCachePoint votes = world_cache_votes.at[cell];
    if (votes.position != 0u) {
        world_cache_points.at[cell] = votes;
        world_cache_votes.at[cell] = WorldCachePoint(0u, 0u);
    }
}
