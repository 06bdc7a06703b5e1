// The light of a lobe in the denoiser: its mean over frames. Radiance is demodulated and linear.
#ifndef PASSES_DENOISE_LOBE_GLSL
#define PASSES_DENOISE_LOBE_GLSL

#include "common/math.glsl"
#include "common/random.glsl"

// A history of frames.
struct Lobe {
    vec3 radiance;           // the mean
    float second_moment;     // the mean of squared luminances
    float recent;            // luminance of the latest frames
    float frames;            // number of frames in the mean; 0 without a history
    float inverse_distance;  // mean of 1 / distance to where the light came from, in 1/m; 0 when unknown
};

const float INVERSE_OF_INFINITY = 1e-9;  // of light from the environment
const Lobe NO_HISTORY = Lobe(vec3(0.0), 0.0, 0.0, 0.0, 0.0);

// ---- packing ----------------------------------------------------------------------------------------

// Positive floats keep all exponents, so that no exposure overflows, and their highest bits of mantissa. Rounding is
// random: rounding to the nearest would stop means of many frames short of where they tend to.
const float LARGEST = 1e37;

uint pack_positive(float value, uint bit_count, inout uint rng) {
    uint dropped = 31u - bit_count;
    return (floatBitsToUint(clamp(value, 0.0, LARGEST)) + (rand_u(rng) >> (32u - dropped))) >> dropped;
}

float unpack_positive(uint bits, uint bit_count) {
    return uintBitsToFloat((bits & ((1u << bit_count) - 1u)) << (31u - bit_count));
}

// Two positive floats in 16 bits each.
uint pack_two(float low, float high, inout uint rng) {
    uint random = rand_u(rng);
    uvec2 bits = floatBitsToUint(clamp(vec2(low, high), 0.0, LARGEST)) + (uvec2(random, random >> 16u) & 0x7FFFu);
    return bits.x >> 15u | bits.y >> 15u << 16u;
}

uvec4 pack_lobe(Lobe lobe, inout uint rng) {
    uint red = pack_positive(lobe.radiance.r, 21u, rng), green = pack_positive(lobe.radiance.g, 21u, rng);
    uint blue = pack_positive(lobe.radiance.b, 21u, rng);
    return uvec4(
        red | green << 21u, green >> 11u | blue << 10u,
        pack_two(lobe.second_moment, lobe.recent, rng), pack_two(lobe.frames, lobe.inverse_distance, rng)
    );
}

Lobe unpack_lobe(uvec4 bits) {
    return Lobe(
        vec3(unpack_positive(bits.x, 21u), unpack_positive(bits.x >> 21u | bits.y << 11u, 21u),
             unpack_positive(bits.y >> 10u, 21u)),
        unpack_positive(bits.z, 16u), unpack_positive(bits.z >> 16u, 16u),
        unpack_positive(bits.w, 16u), unpack_positive(bits.w >> 16u, 16u)
    );
}

#endif
