// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera.
#version 460
#extension GL_EXT_scalar_block_layout : require
#define LOW_DISCREPANCY
#include "passes/pathtracer/from_camera.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Adaptive sampling, planned by solari_vk/output/adaptive.py: the numbers of samples before and after a pass. A block
// of 8x8 pixels is divided like a checkerboard in two halves with numbers of their own. The other half and other blocks
// decide on them, since a mean is biased if its own samples decide when it stops.
// Not with many views, which take the same number.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

uvec2 sample_range(uvec2 pixel) {
#ifdef MANY_VIEWS
    return even_sample_range();
#else
    if (path_sampling.has_sample_ranges == 0u) { return even_sample_range(); }
    uint block = pixel.y / 8u * ((camera.size.x + 7u) / 8u) + pixel.x / 8u;
    uvec2 range = sample_ranges.at[2u * block + (pixel.x + pixel.y) % 2u];
    uvec2 now = range.x + even_sample_range();
    return min(now, range.y);
#endif
}

void main() { trace_paths(); }
