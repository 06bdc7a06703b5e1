// Dispatches over many threads in one dimension, as a grid of rows of workgroups, so that no device's limit on their
// counts is reached.
#ifndef PASSES_ROWS_GLSL
#define PASSES_ROWS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/rows.glsl"

// What an indirect dispatch reads.
struct IndirectDispatch {
    uvec3 group_count;
    uvec3 thread_count;  // the same in threads, for ray pipelines
};

IndirectDispatch make_indirect_dispatch(uint threads) {
    uint groups = (threads + GROUP_SIZE - 1u) / GROUP_SIZE;
    uvec3 group_count = uvec3(min(groups, ROW_GROUPS), (groups + ROW_GROUPS - 1u) / ROW_GROUPS, 1u);
    return IndirectDispatch(group_count, group_count * uvec3(GROUP_SIZE, 1u, 1u));
}

// Which thread of the dispatch an invocation is.
uint thread_index(uvec2 invocation_index) {
    return invocation_index.y * (ROW_GROUPS * GROUP_SIZE) + invocation_index.x;
}

#endif
