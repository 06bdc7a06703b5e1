// Goes on with the paths whose rays trace.comp has traced, as passes/paths/arrive.comp.
#version 460
#include "passes/world_cache/cell_path.glsl"

layout(local_size_x = GROUP_SIZE) in;

layout(constant_id = is_last_wave_id) const bool is_last_wave = false;

void main() {
    uint index = thread_index(INVOCATION_INDEX);
    if (!find_cell_path(index)) { return; }
    WorldCachePath waiting = world_cache_paths.at[index];
    Path path = unpack_path(waiting.state, waiting.rays);
    path.cache_lifetime = world_cache_samples.at[waiting.thread].life & ~SEES_WALL;
    TracedRays traced = unpack_hit(waiting.hit, path.rng);
    bool goes_on = add_rays(path, traced) && arrive(path, false);
    while (is_last_wave && goes_on) {
        choose_rays(path);
        goes_on = add_rays(path, trace_rays(path)) && arrive(path, false);
    }
    add_to_cell(path, waiting.thread);
    if (goes_on) {
        choose_rays(path);
        store_cell_path(path, index);
    } else {
        world_cache_paths.at[index].thread = NO_INDEX;
    }
}
