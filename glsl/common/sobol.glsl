// Points that cover the unit square evenly over consecutive frames or samples: a Sobol sequence in two dimensions with
// nested uniform (Owen) scrambling and shuffling by hashes. Burley, "Practical Hash-based Owen Scrambling" (JCGT 2020).
// Each point alone is uniformly distributed, and points of different seeds are independent.
#ifndef COMMON_SOBOL_GLSL
#define COMMON_SOBOL_GLSL

#include "common/hash.glsl"

// Flips each bit by a hash of the bits above it. The hash is Nathan Vegdahl's improvement (2021) of Laine and Karras's.
uint owen_scramble(uint bits, uint seed) {
    bits = bitfieldReverse(bits);
    bits ^= bits * 0x3D20ADEAu;
    bits += seed;
    bits *= seed >> 16u | 1u;
    bits ^= bits * 0x05526C56u;
    bits ^= bits * 0x53A22864u;
    return bitfieldReverse(bits);
}

// The second dimension of the Sobol sequence, whose generator matrix is Pascal's triangle modulo 2: by Lucas's theorem
// bit j is the sum of all bits i of the index for which i contains the bits of j.
uint sobol_second_dimension(uint index) {
    index ^= (index & 0xFFFF0000u) >> 16u;
    index ^= (index & 0xFF00FF00u) >> 8u;
    index ^= (index & 0xF0F0F0F0u) >> 4u;
    index ^= (index & 0xCCCCCCCCu) >> 2u;
    index ^= (index & 0xAAAAAAAAu) >> 1u;
    return bitfieldReverse(index);
}

// Number `index` of the one-dimensional sequence of a seed, as a fraction of 2^32.
uint van_der_corput(uint index, uint seed) {
    uint shuffled = owen_scramble(index, pcg(seed));
    return owen_scramble(bitfieldReverse(shuffled), pcg(seed ^ 0x68BC21EBu));
}

// Point `index` of the sequence of a seed, in [0, 1).
vec2 sobol_point(uint index, uint seed) {
    uint shuffled = owen_scramble(index, pcg(seed));
    uint x = owen_scramble(bitfieldReverse(shuffled), pcg(seed ^ 0x68BC21EBu));
    uint y = owen_scramble(sobol_second_dimension(shuffled), pcg(seed ^ 0x02E5BE93u));
    return vec2(unit_float(x), unit_float(y));
}

#endif
