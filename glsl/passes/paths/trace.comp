// Traces the rays that paths have chosen. A shader that traverses trees itself waits for memory most of the time, and
// with few registers, as this one has, a GPU runs many threads meanwhile.
#version 460
#include "passes/paths/path_state.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = load_path_with_rays(index);
    TracedRays traced = trace_rays(path);
    store_path_hit(traced, path.rng, index);
}
