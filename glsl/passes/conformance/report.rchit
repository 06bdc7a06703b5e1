// Returns the closest hit with its attributes.
#version 460
#include "passes/conformance/report.glsl"

layout(location = 0) rayPayloadInEXT Reported found;
hitAttributeEXT vec4 attributes;

void main() {
    found.t = gl_HitTEXT;
    found.kind = gl_HitKindEXT;
    found.attributes = attributes;
}
