// The inputs of the reference path tracer and its outputs.
#ifndef PASSES_REFERENCE_BINDINGS_GLSL
#define PASSES_REFERENCE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/first_hits.glsl"  // aov_*, STORE_FIRST_HITS, STORE_GEOMETRY: solari_vk/passes/first_hits.py
#include "generated/passes/reference.glsl"  // LIGHT_STRATEGY_*, PIXEL_FILTER_*, STORED_QUADS: passes/reference.py
#include "passes/rows.glsl"  // IndirectDispatch
#include "scene/camera.glsl"

layout(set = 1, scalar) uniform PathSamplingBlock {
    uint seed;
    uint first_row;             // the dispatch covers rows from here
    uint row_count;
    uint first_sample;          // the picture's first index in the low-discrepancy sequences of its seed
    uint sample_index;          // samples before this dispatch: of each pixel, or of its range in sample_ranges
    uint has_sample_ranges;     // whether sampling is adaptive
    uint samples_per_dispatch;
    uint max_bounces;           // 0: only emission
    uint light_strategy;        // LIGHT_STRATEGY_*
    uint pixel_filter;          // PIXEL_FILTER_*
    float filter_radius;        // in pixels, 0.5 for a box of one pixel
} path_sampling;

layout(set = 1, scalar) buffer RadianceMeanBlock { vec3 at[]; } radiance_mean;
// The sum over a pixel's samples of the squared deviation of luminance from its mean.
layout(set = 1, scalar) buffer LuminanceDeviationsBlock { float at[]; } luminance_deviations;
layout(set = 1, scalar) writeonly buffer AovMotionVectorsBlock { vec2 at[]; } aov_motion_vectors;  // as motion_vectors
layout(set = 1, scalar) buffer RayCountBlock { uint at[]; } ray_count;  // rays of the pixel so far

// Adaptive sampling, planned by solari_vk/output/adaptive.py: the numbers of samples before and after a pass, for each
// half of a block of 8x8 pixels, which is divided like a checkerboard. The number of a half depends on the error of the
// other half and of other blocks, since a mean is biased if its own samples decide when it stops. With many views
// sampling isn't adaptive.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

// ---- paths that wait for the next wave: passes/reference/waves.glsl -------------------------------------

layout(set = 1, scalar) buffer StoredPathsBlock { uvec4 at[]; } stored_paths;  // STORED_QUADS of each path
// The indices of the paths of a wave: those of waves with even index, then those of waves with odd index.
layout(set = 1, scalar) buffer WaveQueuesBlock { uint at[]; } wave_queues;
layout(set = 1, scalar) buffer WaveBlock {
    IndirectDispatch dispatch;
    uint index;   // counted on from dispatch to dispatch
    uint count;   // of paths in this wave
    uint queued;  // of paths that wait for the next wave, so far
} wave;

#endif
