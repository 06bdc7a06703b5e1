// Dispatches over many threads in one dimension, as a grid of rows of workgroups, so that no device's limit on their
// counts is reached.
#ifndef PASSES_ROWS_GLSL
#define PASSES_ROWS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/rows.glsl"  // GROUP_SIZE, the threads of a workgroup, and ROW_GROUPS: passes/rows.py

// What an indirect dispatch reads.
struct IndirectDispatch {
    uvec3 group_count;
    uvec3 thread_count;  // the same in threads, for ray pipelines
};

// As many threads in each layer of a dispatch.
IndirectDispatch make_indirect_dispatch(uint threads, uint layers) {
    uint groups = (threads + GROUP_SIZE - 1u) / GROUP_SIZE;
    uvec3 group_count = uvec3(min(groups, ROW_GROUPS), (groups + ROW_GROUPS - 1u) / ROW_GROUPS, layers);
    return IndirectDispatch(group_count, group_count * uvec3(GROUP_SIZE, 1u, 1u));
}

// Which thread of its layer an invocation is.
uint thread_index(uvec2 invocation_index) {
    return invocation_index.y * (ROW_GROUPS * GROUP_SIZE) + invocation_index.x;
}

// The same for "squares", workgroups of 8 by 8 threads, as passes over pictures have them.
const uint SQUARE = 8u, ROW_SQUARES = 32u;

IndirectDispatch make_indirect_squares(uint threads, uint layers) {
    uint squares = (threads + SQUARE * SQUARE - 1u) / (SQUARE * SQUARE);
    uvec3 group_count = uvec3(min(squares, ROW_SQUARES), (squares + ROW_SQUARES - 1u) / ROW_SQUARES, layers);
    return IndirectDispatch(group_count, group_count * uvec3(SQUARE, SQUARE, 1u));
}

uint thread_index_in_squares(uvec2 invocation_index) {
    uvec2 square = invocation_index / SQUARE, within = invocation_index % SQUARE;
    return ((square.y * ROW_SQUARES + square.x) * SQUARE + within.y) * SQUARE + within.x;
}

#endif
