// The same by the debug build of ray queries.
#version 460
#define RAY_QUERY_DEBUG
#include "passes/conformance/probe.glsl"

layout(local_size_x = 32) in;

void main() {
    if (gl_GlobalInvocationID.x < probes.at.length()) run_probe(gl_GlobalInvocationID.x);
}
