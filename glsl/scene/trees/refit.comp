// Fits trees to triangles that have moved: the nodes stay, and their boxes are computed anew from the leaves up (Wald,
// Boulos and Shirley, "Ray Tracing Deformable Scenes Using Dynamic Bounding Volume Hierarchies", 2007). A tree is
// fitted in place, or made from another one of the same mesh. A thread begins at a node whose children are leaves and
// goes up; where two of them meet, the second goes on: Karras, "Maximizing Parallelism in the Construction of BVHs,
// Octrees, and k-d Trees" (2012). The host puts barriers around this shader itself.
#version 460
#include "scene/trees/making.glsl"

layout(local_size_x = 256) in;

const uint PASSED = 1u << 31;  // in TreeNode.passed, beside the cost, whose sign isn't needed

layout(buffer_reference, scalar, buffer_reference_align = 16) coherent buffer FittedNodes { TreeNode at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) buffer FittedTriangles { TreeTriangle at[]; };

struct TreeRefit {
    Corners corners;  // where the triangles are now
    Indices indices;
    TreeNodes source;  // the tree that has the nodes and the order of triangles
    FittedNodes fitted;
    uint slot_count;  // of both
    float growth;     // of the cost since the tree was built, which is what the host learns
};

layout(buffer_reference, scalar, buffer_reference_align = 8) buffer TreeRefits { TreeRefit at[]; };

layout(push_constant, scalar) uniform Work {
    TreeRefits refits;
    Parts parts;  // refits, and so many slots of their trees
    uint slots;
} work;

TreeRefit refit;

struct Subtree {
    vec3 low;
    vec3 high;
    float cost;  // of the surface area heuristic, times the root's area
};

// Of no triangles too.
float area_of(Subtree tree) { return tree.low.x <= tree.high.x ? half_area(tree.low, tree.high) : 0.0; }

// Writes the triangles of a leaf. Rays hit none that isn't finite.
Subtree fit_leaf(uint leaf) {
    Subtree made = Subtree(vec3(INFINITY), vec3(-INFINITY), 0.0);
    uint begin = leaf & LEAF_FIRST_MASK, count = ((leaf & ~LEAF) >> LEAF_COUNT_SHIFT) + 1u;
    TreeTriangles before = TreeTriangles(leaves_behind(uvec2(refit.source), refit.slot_count));
    FittedTriangles triangles = FittedTriangles(leaves_behind(uvec2(refit.fitted), refit.slot_count));
    for (uint place = begin; place < begin + count; place++) {
        uint number = before.at[place].number;
        uvec3 corners = refit.indices.at[number];
        vec3 a = refit.corners.at[corners.x], b = refit.corners.at[corners.y], c = refit.corners.at[corners.z];
        triangles.at[place] = TreeTriangle(a, number, b, 0u, c, 0u);
        if (!is_finite(a) || !is_finite(b) || !is_finite(c)) { continue; }
        made.low = min(made.low, min(min(a, b), c));
        made.high = max(made.high, max(max(a, b), c));
    }
    made.cost = TRIANGLE_COST * area_of(made) * float(count);
    return made;
}

Subtree join(Subtree a, Subtree b) {
    Subtree made = Subtree(min(a.low, b.low), max(a.high, b.high), a.cost + b.cost);
    made.cost += NODE_COST * area_of(made);
    return made;
}

void set_box(uint slot, bool is_second, Subtree child) {
    if (is_second) {
        refit.fitted.at[slot].second_low = child.low;
        refit.fitted.at[slot].second_high = child.high;
    } else {
        refit.fitted.at[slot].first_low = child.low;
        refit.fitted.at[slot].first_high = child.high;
    }
}

// The child of a node that another thread has fitted. Returns whether it has.
bool other_child(uint slot, bool is_second, float own_cost, out Subtree other) {
    memoryBarrierBuffer();
    uint passed = atomicExchange(refit.fitted.at[slot].passed, floatBitsToUint(own_cost) | PASSED);
    if (passed == 0u) { return false; }
    memoryBarrierBuffer();
    refit.fitted.at[slot].passed = 0u;
    other.low = is_second ? refit.fitted.at[slot].second_low : refit.fitted.at[slot].first_low;
    other.high = is_second ? refit.fitted.at[slot].second_high : refit.fitted.at[slot].first_high;
    other.cost = uintBitsToFloat(passed & ~PASSED);
    return true;
}

void finish(Subtree whole, uint part) {
    set_box(0u, false, whole);
    float built = refit.source.at[0].second_low.x;
    work.refits.at[part].growth = cost_for_ray(whole.cost, area_of(whole)) / built;
}

// Fits a node whose children are leaves, and all above it whose other child is fitted.
void climb(uint slot, uint part) {
    Subtree first = fit_leaf(refit.source.at[slot].first), second = fit_leaf(refit.source.at[slot].second);
    set_box(slot, false, first);
    set_box(slot, true, second);
    Subtree own = join(first, second);
    for (uint height = 1u; height <= MAX_TREE_HEIGHT; height++) {
        uint parent = refit.source.at[slot].slot_count;
        if (parent == 0u) {
            finish(own, part);
            return;
        }
        bool is_second = refit.source.at[parent].second == slot;
        set_box(parent, is_second, own);
        uint sibling = is_second ? refit.source.at[parent].first : refit.source.at[parent].second;
        Subtree other;
        if ((sibling & LEAF) != 0u) {
            other = fit_leaf(sibling);
            set_box(parent, !is_second, other);
        } else if (!other_child(parent, !is_second, own.cost, other)) {
            return;
        }
        own = join(own, other);
        slot = parent;
    }
}

void fit_from(uint slot, uint part) {
    uint first = refit.source.at[slot].first, second = refit.source.at[slot].second;
    refit.fitted.at[slot].first = first;
    refit.fitted.at[slot].second = second;
    refit.fitted.at[slot].slot_count = refit.source.at[slot].slot_count;
    if (slot == 0u) {
        refit.fitted.at[slot].second_low = refit.source.at[slot].second_low;
        if ((first & LEAF) != 0u) { finish(fit_leaf(first), part); }
    } else if ((first & second & LEAF) != 0u) {
        climb(slot, part);
    }
}

void main() {
    uvec2 part = work.parts.at[gl_WorkGroupID.x];
    refit = work.refits.at[part.x];
    uint begin = work.slots * part.y, end = min(begin + work.slots, refit.slot_count);
    for (uint slot = begin + gl_LocalInvocationIndex; slot < end; slot += THREADS) { fit_from(slot, part.x); }
}
