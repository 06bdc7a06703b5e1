// Merges what two pixels found, for every pair of their samples and a grid of choices.
#version 460
#include "passes/solari019/restir_gi/reservoir.glsl"

layout(local_size_x = 64) in;
layout(constant_id = CHOICES_id) const uint CHOICES = 1u;

struct Pixel {
    vec3 position;
    vec3 normal;
    vec3 geometric_normal;
};

struct MergeCase {
    uint own;     // into pixels
    uint other;
    GiReservoir found;
    GiReservoir other_found;
};

layout(set = 1, scalar) readonly buffer PixelsBlock { Pixel at[]; } pixels;
layout(set = 1, scalar) readonly buffer CasesBlock { MergeCase at[]; } cases;
layout(set = 1, scalar) buffer MergedBlock { GiReservoir at[]; } merged;

GBufferSurface surface_at(Pixel pixel) {
    GBufferSurface surface;
    surface.exists = true;
    surface.world_position = pixel.position;
    surface.world_normal = pixel.normal;
    surface.geometric_world_normal = pixel.geometric_normal;
    surface.ray_offset = 1e-5;
    return surface;
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= merged.at.length()) { return; }
    MergeCase c = cases.at[i / CHOICES];
    float choice = smoothstep(0.0, 1.0, (float(i % CHOICES) + 0.5) / float(CHOICES));
    GiMerge merge = merge_gi_reservoirs(
        surface_at(pixels.at[c.own]), c.found, surface_at(pixels.at[c.other]), c.other_found, true, choice
    );
    merged.at[i] = apply_merge(merge, merge.other_chosen ? c.other_found : c.found);
}
