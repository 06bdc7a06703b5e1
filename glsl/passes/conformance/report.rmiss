// Returns that no report was accepted.
#version 460
#include "passes/conformance/report.glsl"

layout(location = 0) rayPayloadInEXT Reported found;

void main() {
    found.t = -1.0;
}
