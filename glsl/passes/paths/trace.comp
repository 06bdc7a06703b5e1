// Traces the rays that paths have chosen. A shader that traverses trees itself waits for memory most of the time, and
// with few registers, as this one has, a GPU runs many threads meanwhile.
#version 460
#include "passes/paths/path_state.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = unpack_path(paths_states.at[index], paths_rays.at[index]);
    paths_hits.at[index] = pack_hit(trace_rays(path));
    paths_states.at[index].rng = path.rng;
}
