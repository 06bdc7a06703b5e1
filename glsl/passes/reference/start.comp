// Starts the paths of a dispatch: wave 0.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint index = thread_index(INVOCATION_INDEX);
    uvec2 pixel;
    uint sample_index;
    if (!find_path(index, pixel, sample_index)) { return; }
    WaitingPath waiting;
    begin_path(waiting.path);
    begin_random_numbers(pixel, sample_index, 0u, waiting.rng);
    Vertex unused;
    start_path(pixel, waiting.path, unused, waiting.rng);
    waiting.path.walk.medium = find_medium(start_position(pixel));
    waiting.walks = true;
    waiting_paths.at[index] = waiting;
    queue_path(index, 0u);
}
