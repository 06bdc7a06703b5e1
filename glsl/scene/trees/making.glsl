// What builds and refits of trees share.
#ifndef SCENE_TREES_MAKING_GLSL
#define SCENE_TREES_MAKING_GLSL

#include "common/math.glsl"
#include "scene/trees/tree.glsl"

const uint THREADS = 256u;  // of a workgroup
// Costs of the surface area heuristic (Goldsmith and Salmon 1987), of a node and of a triangle.
const float NODE_COST = 1.2;
const float TRIANGLE_COST = 1.0;

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Corners { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Indices { uvec3 at[]; };
// Which record each workgroup works on, and its part of that work.
layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer Parts { uvec2 at[]; };

const TreeNode NO_NODE = TreeNode(vec3(0.0), NO_ROOT, vec3(0.0), 0u, vec3(0.0), 0u, vec3(0.0), 0u);

float half_area(vec3 low, vec3 high) {
    vec3 size = high - low;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}

// The cost of a tree for a ray that meets the box around it.
float cost_for_ray(float cost, float area) { return area > 0.0 ? cost / area : 0.0; }

bool is_finite(vec3 v) { return all(lessThanEqual(abs(v), vec3(3.4028235e38))); }  // comparisons with NaN are false

#endif
