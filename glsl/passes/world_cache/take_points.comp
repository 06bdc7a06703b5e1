// World cache, in each round of the fill: takes the point that represents each cell in this round from its queries.
#version 460
#include "passes/world_cache/update.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint place = place_in_list(thread_index(gl_GlobalInvocationID.xy));
    if (place >= world_cache_counters.active_cells) { return; }
    uint cell = world_cache_active_cells.at[place];
    take_voted_point(cell);
    world_cache_samples.at[place].life = world_cache_life.at[cell];
}
