// Traces the paths that the last wave has left to their ends.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = waiting_paths.at[index];
    do { trace_rays(waiting); } while (waiting.walks && shade(waiting, pixel, sample_index));
    waiting_paths.at[index].path = waiting.path;
}
