// What antialiasing keeps from frame to frame, for each pixel of the picture; packed by passes/taa/history.glsl.
#ifndef PASSES_TAA_BINDINGS_GLSL
#define PASSES_TAA_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/rows.glsl"  // IndirectDispatch

layout(set = 1, scalar) buffer TaaHistoryBlock { uvec2 at[]; } taa_history;
layout(set = 1, scalar) buffer PreviousTaaHistoryBlock { uvec2 at[]; } previous_taa_history;

// This frame's samples, and those of the previous one, by pack_color.
layout(set = 1, scalar) buffer TaaSamplesBlock { uint at[]; } taa_samples;
layout(set = 1, scalar) buffer PreviousTaaSamplesBlock { uint at[]; } previous_taa_samples;

// Packed by passes/taa/strata.glsl. No history, as it is for pixels at rest alone.
layout(set = 1, scalar) buffer TaaStrataBlock { uvec4 at[]; } taa_strata;

// How the samples of a cell of CELL_SIZE x CELL_SIZE rendered pixels differ from those of the previous frame at the
// same surfaces: passes/taa/change.comp.
struct SampleChange {
    vec3 difference_sum;
    vec3 sum_of_squares;  // of the differences
    vec3 sum_of_max;      // the larger of both samples
    vec3 sum_of_sizes;    // of the differences
    vec3 sum_of_shares;   // the squared differences over the larger samples
};

void add_change(inout SampleChange sum, SampleChange other) {
    sum.difference_sum += other.difference_sum;
    sum.sum_of_squares += other.sum_of_squares;
    sum.sum_of_max += other.sum_of_max;
    sum.sum_of_sizes += other.sum_of_sizes;
    sum.sum_of_shares += other.sum_of_shares;
}

layout(set = 1, scalar) buffer TaaChangesBlock { SampleChange at[]; } taa_changes;
// For each cell the share of the history around it that is still true: passes/taa/confidence.comp.
layout(set = 1, scalar) buffer TaaConfidenceBlock { float at[]; } taa_confidence;

// The pixels, of all views, that passes/taa/coverage.comp traces camera rays of, and their number. NEEDS_LIGHT: it
// writes the light of these to `radiance`, which find_edges.comp sets to NO_COVERAGE.
const uint NEEDS_LIGHT = 0x80000000u;
const vec3 NO_COVERAGE = vec3(-1.0);
layout(set = 1, scalar) buffer TaaEdgesBlock { uint at[]; } taa_edges;
layout(set = 1, scalar) buffer TaaCoverageBlock {
    IndirectDispatch dispatch;
    uint listed;
    uint found;  // so far, by passes/taa/find_edges.comp
} taa_coverage;

#endif
