// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera.
#version 460
#extension GL_EXT_scalar_block_layout : require
#define LOW_DISCREPANCY
#include "passes/pathtracer/from_camera.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The samples that pixels have and shall have, of each half of a block of 8x8, divided like a checkerboard.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

uvec2 sample_range(uvec2 pixel) {
    if (path_sampling.has_sample_ranges == 0u) { return even_sample_range(); }
    uint block = pixel.y / 8u * ((camera.size.x + 7u) / 8u) + pixel.x / 8u;
    uvec2 range = sample_ranges.at[2u * block + (pixel.x + pixel.y) % 2u];
    uvec2 now = range.x + even_sample_range();
    return min(now, range.y);
}

void main() { trace_paths(); }
