// A million draws of one distribution, in the frame whose z axis is the normal.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "common/random.glsl"

layout(local_size_x = 64) in;

// kind, seed, axis and cone
layout(set = 1, scalar) readonly buffer ParametersBlock { uint at[]; } parameters;
layout(set = 1, scalar) buffer DrawsBlock { vec3 at[]; } draws;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= draws.at.length()) { return; }
    uint rng = seed_rng(uvec2(i, 0u), 0u, parameters.at[1]);
    vec2 u = rand_vec2f(rng);
    vec3 axis = vec3(
        uintBitsToFloat(parameters.at[2]), uintBitsToFloat(parameters.at[3]), uintBitsToFloat(parameters.at[4])
    );
    float cone = uintBitsToFloat(parameters.at[5]);
    switch (parameters.at[0]) {
        case 0u: draws.at[i] = vec3(sample_disk(u), 0.0); break;
        case 1u: draws.at[i] = sample_cosine_hemisphere(u); break;
        case 2u: draws.at[i] = sample_uniform_hemisphere(u); break;
        case 3u: draws.at[i] = sample_cone(axis, cone, u); break;
        default: draws.at[i] = vec3(sample_triangle_barycentrics(u), 0.0); break;
    }
}
