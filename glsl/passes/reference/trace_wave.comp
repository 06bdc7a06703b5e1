// Traces the rays of a wave's paths, and nothing else: passes/paths/trace.comp says why.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index, sample_index;
    uvec2 pixel;
    if (!find_waiting_path(INVOCATION_INDEX, index, pixel, sample_index)) { return; }
    WaitingPath waiting = waiting_paths.at[index];
    trace_rays(waiting);
    waiting_paths.at[index].segment = waiting.segment;
    waiting_paths.at[index].path.radiance = waiting.path.radiance;
    waiting_paths.at[index].path.rays = waiting.path.rays;
    waiting_paths.at[index].rng = waiting.rng;
}
