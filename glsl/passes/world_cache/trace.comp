// Traces the rays of paths from cells: as passes/paths/trace.comp.
#version 460
#include "passes/world_cache/cell_path.glsl"

layout(local_size_x = GROUP_SIZE) in;

layout(constant_id = is_first_wave_id) const bool is_first_wave = false;

void main() {
    uint index = thread_index(INVOCATION_INDEX);
    if (!find_cell_path(index)) { return; }
    WorldCachePath waiting = world_cache_paths.at[index];
    Path path = unpack_path(waiting.state, waiting.rays);
    TracedRays traced = trace_rays(path);
    world_cache_paths.at[index].hit = pack_hit(traced, path.rng);
    if (is_first_wave) { test_for_wall(world_cache_active_cells.at[waiting.thread], waiting.thread); }
}
