// Runs every probe from a fragment shader: the pixel's x is the probe.
#version 460
#extension GL_EXT_ray_query : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#include "conformance/probe.glsl"

layout(location = 0) out uint kind;

void main() {
    uint index = uint(gl_FragCoord.x);
    run_probe(index);
    kind = answers.at[index].committed.kind + 1u;
}
