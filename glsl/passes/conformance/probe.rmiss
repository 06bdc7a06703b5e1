// Records that a probe hit nothing.
#version 460
#include "passes/conformance/probe_rays.glsl"

layout(location = 0) rayPayloadInEXT uint ended;

void main() {
    atomicAdd(RAY_ANSWER.misses, 1u);
    RECORD_RAY
    ended = ENDED_AT_MISS;
}
