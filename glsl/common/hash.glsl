// Hashes of integers, from which random numbers are made. Jarzynski and Olano, "Hash Functions for GPU Rendering"
// (JCGT 2020).
#ifndef COMMON_HASH_GLSL
#define COMMON_HASH_GLSL

#include "common/math.glsl"

uint pcg(uint v) {
    uint state = v * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

uvec4 pcg4d(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    v ^= v >> 16u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    return v;
}

// The initial state of the generator for a pixel, a seed, and a number, such as that of a sample or of a bounce.
uint seed_rng(uvec2 pixel, uint number, uint seed) {
    return pcg4d(uvec4(pixel, number, seed)).x;
}

// The upper 24 bits as a number in [0, 1).
float unit_float(uint bits) { return float(bits >> 8u) * ROUNDING_UNIT; }

#endif
