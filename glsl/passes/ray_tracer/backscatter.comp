// The hits of rays from a user's arrays, and the light that surfaces scatter back along them.
#version 460
#define BACKSCATTER
#include "passes/ray_tracer/trace.glsl"

layout(local_size_x = 64) in;

void main() { trace_rays(); }
