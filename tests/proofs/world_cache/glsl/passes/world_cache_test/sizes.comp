// The sizes of the cells that are queried at given positions.
#version 460
#include "passes/world_cache/query.glsl"

layout(set = 1, scalar) readonly buffer PlacesBlock { vec3 at[]; } places;
layout(set = 1, scalar) buffer SizesBlock { float at[]; } sizes;

layout(local_size_x = 64) in;

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index >= places.at.length()) { return; }
    uint rng = seed_rng(uvec2(index, 1u), this_frame.index, this_frame.seed);
    sizes.at[index] = get_cell_size(places.at[index], rng);
}
