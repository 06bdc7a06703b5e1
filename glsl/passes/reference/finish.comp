// Traces the paths that the last wave has left to their ends.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = load_path(index);
    while (has_rays(waiting)) {
        Segment segment = trace_rays(waiting);
        if (!waiting.walks) { break; }
        shade(waiting, segment, pixel, sample_index);
    }
    store_radiance(index, waiting.path);
}
