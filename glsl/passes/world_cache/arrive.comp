// Adds the light that the rays of trace.comp have found, moves each path to the surface that its ray has hit, and
// chooses the next rays. The last wave traces all that are left.
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
    bool are_traced = true, goes_on;
    do {
        TracedRays traced;
        if (are_traced || !is_last_wave) {
            traced = unpack_hit(waiting.hit);
        } else {
            traced = trace_rays(path);
        }
        are_traced = false;
        goes_on = add_rays(path, traced) && arrive(path, false);
        if (goes_on) { choose_rays(path); }
    } while (goes_on && is_last_wave);
    add_to_cell(path, waiting.thread);
    world_cache_paths.at[index].state.flags = NO_PATH_STATE;
    if (goes_on) { store_cell_path(path, index); }
}
