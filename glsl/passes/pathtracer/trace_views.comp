// The reference path tracer of many views: what trace.comp computes, for all views in one strip.
#version 460
#define LOW_DISCREPANCY
#define MANY_VIEWS
#include "passes/pathtracer/from_camera.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

uvec2 sample_range(uvec2 pixel) { return even_sample_range(); }

void main() { trace_paths(); }
