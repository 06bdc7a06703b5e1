// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera. Random
// numbers are of low-discrepancy sequences over samples: LOW_DISCREPANCY in common/random.glsl.
#version 460
#extension GL_EXT_scalar_block_layout : require
#define LOW_DISCREPANCY
#include "passes/reference/from_camera.glsl"  // and trace.glsl: trace_paths, which calls sample_range

layout(local_size_x = 8, local_size_y = 8) in;

// Adaptive sampling, planned by solari_vk/output/adaptive.py: the numbers of samples before and after a pass, for each
// half of a block of 8x8 pixels, which is divided like a checkerboard. The number of a half depends on the error of the
// other half and of other blocks, since a mean is biased if its own samples decide when it stops. With many views
// sampling isn't adaptive.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

uvec2 sample_range(uvec2 pixel) {
#ifdef MANY_VIEWS
    return uniform_sample_range();
#else
    if (path_sampling.has_sample_ranges == 0u) { return uniform_sample_range(); }
    uint block = pixel.y / 8u * ((camera.size.x + 7u) / 8u) + pixel.x / 8u;
    uvec2 range = sample_ranges.at[2u * block + (pixel.x + pixel.y) % 2u];
    uvec2 this_dispatch = range.x + uniform_sample_range();  // counted from the first sample of the range
    return min(this_dispatch, range.y);
#endif
}

void main() { trace_paths(); }
