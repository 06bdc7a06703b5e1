// Points of the Sobol sequence, and its parts, as the library computes them.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "common/sobol.glsl"

layout(local_size_x = 64) in;

layout(set = 1, scalar) readonly buffer AskedBlock { uvec2 at[]; } asked;  // index, seed
layout(set = 1, scalar) buffer PointsBlock { vec2 at[]; } points;
layout(set = 1, scalar) buffer PartsBlock { uvec2 at[]; } parts;  // scrambled index, second dimension

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= asked.at.length()) { return; }
    points.at[i] = sobol_point(asked.at[i].x, asked.at[i].y);
    parts.at[i] = uvec2(owen_scramble(asked.at[i].x, asked.at[i].y), sobol_second_dimension(asked.at[i].x));
}
