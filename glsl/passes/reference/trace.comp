// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera.
#version 460
#include "passes/reference/from_camera.glsl"
#include "passes/reference/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() { trace_paths(); }
