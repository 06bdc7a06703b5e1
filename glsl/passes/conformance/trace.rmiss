// The answer of a ray that hits nothing.
#version 460
#extension GL_EXT_ray_tracing : require
#include "passes/conformance/trace_rays.glsl"

layout(location = 0) rayPayloadInEXT Hit hit;

void main() {
    hit = Hit(-1.0, 0u, 0u, 0u, 0u);
}
