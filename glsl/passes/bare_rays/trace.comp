// Traces rays from buffers and writes the distance of each hit, nothing else: the baseline of `RayTracer.trace`.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/trace.glsl"

layout(local_size_x = 64) in;

layout(set = 1, scalar) readonly buffer PlainOriginsBlock { vec3 at[]; } plain_origins;
layout(set = 1, scalar) readonly buffer PlainDirectionsBlock { vec3 at[]; } plain_directions;
layout(set = 1, scalar) writeonly buffer PlainDistancesBlock { float at[]; } plain_distances;

void main() {
    uint i = INVOCATION_INDEX.x;
    if (i >= plain_origins.at.length()) { return; }
    plain_distances.at[i] =
        trace_closest_hit(plain_origins.at[i], 0.0, plain_directions.at[i], INFINITY, TRACE_BOTH_FACES).t;
}
