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
    bool goes_on = add_rays(path, unpack_hit(waiting.hit)) && arrive(path, false);
    while (is_last_wave && goes_on) { goes_on = advance(path); }
    add_to_cell(path, waiting.thread);
    world_cache_paths.at[index].state.flags = NO_PATH_STATE;
    if (goes_on) {
        choose_rays(path);
        store_cell_path(path, index);
    }
}
