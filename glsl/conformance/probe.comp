// Runs every probe from a compute shader.
#version 460
#extension GL_EXT_ray_query : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "conformance/probe.glsl"

layout(local_size_x = 32) in;

void main() {
    if (gl_GlobalInvocationID.x < probes.at.length()) run_probe(gl_GlobalInvocationID.x);
}
