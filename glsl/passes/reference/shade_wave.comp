// Shades what the rays of a wave's paths have hit, and chooses the rays of the next wave.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = load_path(index);
    if (!waiting.walks) { return; }  // it had a shadow ray
    Segment segment = load_segment(index, waiting.rng);
    shade(waiting, segment, pixel, sample_index);
    if (has_rays(waiting)) {
        store_path(index, waiting);
        queue_path(index);
    } else {
        store_radiance(index, waiting.path);
    }
}
