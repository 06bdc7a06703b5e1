// Records the reported hit of an AABB.
#version 460
#include "passes/conformance/probe_rays.glsl"

layout(location = 0) rayPayloadInEXT uint ended;

void main() {
    atomicAdd(RAY_ANSWER.closest_hits, 1u);
    RAY_ANSWER.committed = FOUND(RAY_QUERY_INTERSECTION_GENERATED, gl_HitTEXT, vec2(0.0), 0u);
    RAY_ANSWER.hit_kind = gl_HitKindEXT;
    RECORD_RAY
    ended = ENDED_AT_HIT;
}
