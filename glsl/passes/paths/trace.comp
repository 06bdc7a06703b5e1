// Traces the rays of each path that waits, for shade.comp. Without shading, a shader that traverses trees itself has few
// registers, so that many more of its threads run at a time.
#version 460
#include "passes/paths/path_state.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = load_path_state(index);
    TracedRays traced = trace_rays(path);
    store_traced_rays(traced, path.rng, index);
}
