// Goes on with the paths whose first rays trace.comp has traced.
#version 460
#include "passes/world_cache/cell_path.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index = thread_index(INVOCATION_INDEX);
    if (!find_cell_path(index)) { return; }
    WorldCachePath waiting = world_cache_paths.at[index];
    Path path = unpack_path(waiting.state, waiting.rays);
    path.cache_lifetime = world_cache_samples.at[waiting.thread].life & ~SEES_WALL;
    TracedRays traced = unpack_hit(waiting.hit, path.rng);
    while (add_rays(path, traced) && arrive(path, false)) {
        choose_rays(path);
        traced = trace_rays(path);
    }
    add_to_cell(path, waiting.thread);
}
