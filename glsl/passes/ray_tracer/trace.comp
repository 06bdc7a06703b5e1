// The hits of rays from a user's arrays.
#version 460
#include "passes/ray_tracer/trace.glsl"

layout(local_size_x = 64) in;

void main() { trace_rays(); }
