// Counts a miss, and traces another ray: onto the triangle.
#version 460
#include "passes/conformance/nested.glsl"

layout(location = 0) rayPayloadInEXT Nested found;
layout(location = 1) rayPayloadEXT Nested next;

void main() {
    found.misses += 1u;
    if (found.depth > 0u) { return; }
    next = Nested(1u, 0u, 0u);
    traceRay(tlas, RayDesc(RAY_FLAG_NONE, 0xFFu, 0.0, 9.0, vec3(0.6, 0.3, 5.0), vec3(0.0, 0.0, -1.0)), 1);
    found.hits += 10u * next.hits;
    found.misses += 10u * next.misses;
}
