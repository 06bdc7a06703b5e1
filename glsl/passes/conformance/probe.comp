// Runs every probe from a compute shader.
#version 460
#include "passes/conformance/probe.glsl"

layout(local_size_x = 32) in;

void main() {
    if (gl_GlobalInvocationID.x < probes.at.length()) run_probe(gl_GlobalInvocationID.x);
}
