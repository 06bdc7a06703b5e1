// Records the triangle that a probe hit.
#version 460
#include "passes/conformance/probe_rays.glsl"

layout(location = 0) rayPayloadInEXT uint ended;
hitAttributeEXT vec2 barycentrics;

void main() {
    atomicAdd(RAY_ANSWER.closest_hits, 1u);
    uint front_face = gl_HitKindEXT == gl_HitKindFrontFacingTriangleEXT ? 1u : 0u;
    RAY_ANSWER.committed = FOUND(RAY_QUERY_INTERSECTION_TRIANGLE, gl_HitTEXT, barycentrics, front_face);
    RAY_ANSWER.hit_kind = gl_HitKindEXT;
    RECORD_RAY
    ended = ENDED_AT_HIT;
}
