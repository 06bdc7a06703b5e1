// Hashes and generators as the library computes them.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "common/random.glsl"

layout(local_size_x = 64) in;

layout(set = 1, scalar) readonly buffer WordsBlock { uvec4 at[]; } words;
layout(set = 1, scalar) buffer HashesBlock { uint at[]; } hashes;    // pcg, pcg4d, seed: 6 each
layout(set = 1, scalar) buffer NumbersBlock { uint at[]; } numbers;  // a sequence of 8 each
layout(set = 1, scalar) buffer FloatsBlock { float at[]; } floats;   // the same sequence
layout(set = 1, scalar) buffer RangedBlock { uint at[]; } ranged;    // and in [0, words.y)

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= words.at.length()) { return; }
    uvec4 word = words.at[i];
    hashes.at[6u * i] = pcg(word.x);
    uvec4 four = pcg4d(word);
    for (uint k = 0u; k < 4u; k++) { hashes.at[6u * i + 1u + k] = four[k]; }
    uint rng = seed_rng(word.xy, word.z, word.w);
    hashes.at[6u * i + 5u] = rng;
    uint float_rng = rng, range_rng = rng;
    for (uint k = 0u; k < 8u; k++) {
        numbers.at[8u * i + k] = rand_u(rng);
        floats.at[8u * i + k] = rand_f(float_rng);
        ranged.at[8u * i + k] = rand_range_u(word.y, range_rng);
    }
}
