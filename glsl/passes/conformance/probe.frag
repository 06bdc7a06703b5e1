// Runs every probe from a fragment shader: the pixel's x is the probe.
#version 460
#include "passes/conformance/probe.glsl"

layout(location = 0) out uint kind;

void main() {
    uint index = uint(gl_FragCoord.x);
    run_probe(index);
    kind = answers.at[index].committed.kind + 1u;
}
