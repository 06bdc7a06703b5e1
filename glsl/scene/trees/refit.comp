// Fits trees to triangles that have moved, each by one workgroup: the nodes stay, and their boxes are computed anew
// from the leaves up (Wald, Boulos and Shirley, "Ray Tracing Deformable Scenes Using Dynamic Bounding Volume
// Hierarchies", 2007). A tree is fitted in place, or made from another one of the same mesh. The host puts barriers
// around this shader itself.
#version 460
#include "common/math.glsl"
#include "scene/trees/tree.glsl"

layout(local_size_x = 256) in;

const uint THREADS = 256u;

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Corners { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Indices { uvec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) coherent buffer FittedNodes { TreeNode at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) coherent buffer FittedTriangles { TreeTriangle at[]; };

struct TreeRefit {
    Corners corners;  // where the triangles are now
    Indices indices;
    uvec2 source;     // the tree that has the nodes and the order of triangles
    uvec2 fitted;
    uint slot_count;  // of both
    uint triangle_count;
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer TreeRefits { TreeRefit at[]; };

layout(push_constant, scalar) uniform Work {
    TreeRefits refits;
} work;

shared bool changed;

struct Box {
    vec3 low;
    vec3 high;
};

bool is_finite(vec3 v) { return all(lessThanEqual(abs(v), vec3(3.4028235e38))); }  // comparisons with NaN are false

void write_triangles(TreeRefit refit) {
    FittedTriangles triangles = FittedTriangles(leaves_behind(refit.fitted, refit.slot_count));
    TreeTriangles before = TreeTriangles(leaves_behind(refit.source, refit.slot_count));
    for (uint place = gl_LocalInvocationIndex; place < refit.triangle_count; place += THREADS) {
        uint number = before.at[place].number;
        uvec3 corners = refit.indices.at[number];
        triangles.at[place] = TreeTriangle(
            refit.corners.at[corners.x], number, refit.corners.at[corners.y], 0u, refit.corners.at[corners.z], 0u
        );
    }
}

// The box around a child as it is by now. Rays hit no triangle that isn't finite.
Box box_of(TreeRefit refit, uint child) {
    Box box = Box(vec3(INFINITY), vec3(-INFINITY));
    if ((child & LEAF) == 0u) {
        if (child >= refit.slot_count) { return box; }  // of a slot without a node
        TreeNode node = FittedNodes(refit.fitted).at[child];
        return Box(min(node.first_low, node.second_low), max(node.first_high, node.second_high));
    }
    uint begin = child & LEAF_FIRST_MASK;
    uint end = min(begin + ((child & ~LEAF) >> LEAF_COUNT_SHIFT) + 1u, refit.triangle_count);
    for (uint place = begin; place < end; place++) {
        TreeTriangle found = FittedTriangles(leaves_behind(refit.fitted, refit.slot_count)).at[place];
        if (!is_finite(found.a) || !is_finite(found.b) || !is_finite(found.c)) { continue; }
        box.low = min(box.low, min(min(found.a, found.b), found.c));
        box.high = max(box.high, max(max(found.a, found.b), found.c));
    }
    return box;
}

// Computes the boxes of a node anew; returns whether they have changed.
bool fit(TreeRefit refit, uint slot, TreeNode node) {
    TreeNode fitted = node;
    if (slot > 0u || node.first != NO_ROOT) {
        Box box = box_of(refit, node.first);
        fitted.first_low = box.low;
        fitted.first_high = box.high;
    }
    if (slot > 0u) {
        Box box = box_of(refit, node.second);
        fitted.second_low = box.low;
        fitted.second_high = box.high;
    }
    FittedNodes(refit.fitted).at[slot] = fitted;
    return fitted.first_low != node.first_low || fitted.first_high != node.first_high
        || fitted.second_low != node.second_low || fitted.second_high != node.second_high;
}

void wait_for_all() {
    memoryBarrierBuffer();
    memoryBarrierShared();
    barrier();
}

void main() {
    TreeRefit refit = work.refits.at[gl_WorkGroupID.x];
    write_triangles(refit);
    wait_for_all();
    for (uint slot = gl_LocalInvocationIndex; slot < refit.slot_count; slot += THREADS) {
        fit(refit, slot, TreeNodes(refit.source).at[slot]);
    }
    // After each round the boxes of one more level above the leaves are right, and no path to a leaf is longer.
    for (uint round = 0u; round <= MAX_TREE_HEIGHT; round++) {
        wait_for_all();
        if (gl_LocalInvocationIndex == 0u) { changed = false; }
        wait_for_all();
        for (uint slot = gl_LocalInvocationIndex; slot < refit.slot_count; slot += THREADS) {
            if (fit(refit, slot, FittedNodes(refit.fitted).at[slot])) { changed = true; }
        }
        wait_for_all();
        if (!changed) { break; }
    }
}
