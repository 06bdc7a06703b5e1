// Shades what the rays of a wave's paths have hit, and chooses the rays of the next wave.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = waiting_paths.at[index];
    if (!waiting.walks) { return; }
    bool waits = shade(waiting, pixel, sample_index);
    waiting_paths.at[index] = waiting;
    if (waits) { queue_path(index, wave.index + 1u); }
}
