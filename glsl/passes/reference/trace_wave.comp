// Traces the rays of a wave's paths, and nothing else.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = load_path(index);
    Segment segment = trace_rays(waiting);
    store_radiance(index, waiting.path);
    if (waiting.walks) { store_segment(index, segment, waiting.rng); }
}
