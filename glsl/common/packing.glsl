// Compact encodings of directions and colors. Octahedral normals: Cigolle et al., "A Survey of Efficient
// Representations for Independent Unit Vectors" (JCGT 2014).
#ifndef COMMON_PACKING_GLSL
#define COMMON_PACKING_GLSL

#include "common/math.glsl"
#include "common/random.glsl"

// ---- unsigned normalized numbers, rounded to the nearest ---------------------------------------------

uint pack_unorm(float value, uint bit_count) {
    float max_code = float((1u << bit_count) - 1u);
    return uint(saturate(value) * max_code + 0.5);
}

float unpack_unorm(uint bits, uint bit_count) {
    uint max_code = (1u << bit_count) - 1u, code = bits & max_code;
    return code == max_code ? 1.0 : float(code) / float(max_code);  // on some devices n / n isn't exactly 1
}

// ---- positive floats ----------------------------------------------------------------------------------

// Positive floats keep all exponents, so that no exposure overflows, and their highest bits of mantissa. Rounding is
// stochastic: rounding to the nearest would stop means of many frames short of where they tend to.
const float LARGEST_PACKED = 1e37;

uint pack_positive(float value, uint bit_count, inout uint rng) {
    uint dropped = 31u - bit_count;
    return (floatBitsToUint(clamp(value, 0.0, LARGEST_PACKED)) + (rand_u(rng) >> (32u - dropped))) >> dropped;
}

float unpack_positive(uint bits, uint bit_count) {
    return uintBitsToFloat((bits & ((1u << bit_count) - 1u)) << (31u - bit_count));
}

// Two positive floats in 16 bits each.
uint pack_two(float low, float high, inout uint rng) {
    uint random = rand_u(rng);
    uvec2 bits = floatBitsToUint(clamp(vec2(low, high), 0.0, LARGEST_PACKED)) + (uvec2(random,
        random >> 16u) & 0x7FFFu);
    return bits.x >> 15u | bits.y >> 15u << 16u;
}

// ---- colors ------------------------------------------------------------------------------------------

// Eight bits a channel with a shared exponent (RGBE), that of the largest channel, which is scaled to between 127.5 and
// 255, so that the dither of less than 1 doesn't overflow. Exponents below 8 would make a scale denormal. random: 30
// bits, for stochastic rounding.
uint pack_color(vec3 color, uint random) {
    color = clamp(color, 0.0, LARGEST_PACKED);
    uint exponent = max(floatBitsToUint(max_component(color)) >> 23u, 8u);
    float scale = 255.0 / 256.0 * uintBitsToFloat(261u - exponent << 23u);
    vec3 dither = vec3(ivec3(int(random), int(random >> 10u), int(random >> 20u)) & 0x3FF) / 1024.0;
    uvec3 codes = uvec3(ivec3(color * scale + dither));
    return codes.r | codes.g << 8u | codes.b << 16u | exponent << 24u;
}

vec3 unpack_color(uint bits) {
    float scale = 256.0 / 255.0 * uintBitsToFloat((bits >> 24u) - 7u << 23u);
    return scale * vec3(ivec3(int(bits), int(bits >> 8u), int(bits >> 16u)) & 0xFF);
}

// ---- unit vectors -----------------------------------------------------------------------------------

vec2 octahedral_wrap(vec2 v) {
    return (1.0 - abs(v.yx)) * vec2(v.x >= 0.0 ? 1.0 : -1.0, v.y >= 0.0 ? 1.0 : -1.0);
}

// From a unit vector to the unit square.
vec2 octahedral_encode(vec3 direction) {
    vec3 n = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
    return (n.z >= 0.0 ? n.xy : octahedral_wrap(n.xy)) * 0.5 + 0.5;
}

vec3 octahedral_decode(vec2 position) {
    vec2 f = position * 2.0 - 1.0;
    float z = 1.0 - abs(f.x) - abs(f.y);
    return normalize(vec3(z >= 0.0 ? f : octahedral_wrap(f), z));
}

// The codes 0 to 2^b - 2 have a center code, so that the axes are stored exactly.
uint pack_octahedral(vec3 direction, uint bits_each) {
    float max_code = float((1u << bits_each) - 2u);
    uvec2 code = uvec2(clamp(octahedral_encode(direction), 0.0, 1.0) * max_code + 0.5);
    return code.x | code.y << bits_each;
}

vec3 unpack_octahedral(uint bits, uint bits_each) {
    uint mask = (1u << bits_each) - 1u;
    float max_code = float(mask - 1u);
    return octahedral_decode(vec2(bits & mask, bits >> bits_each & mask) / max_code);
}

uint pack_octahedral_2x16(vec3 direction) { return pack_octahedral(direction, 16u); }
vec3 unpack_octahedral_2x16(uint bits) { return unpack_octahedral(bits, 16u); }

// 12 bits each; the upper 8 bits are 0.
uint pack_octahedral_24(vec3 direction) { return pack_octahedral(direction, 12u); }
vec3 unpack_octahedral_24(uint bits) { return unpack_octahedral(bits, 12u); }

// ---- shared exponent: EXT_texture_shared_exponent, 9 bits a color, 5 of exponent ---------------------

const float RGB9E5_MAX = 65408.0;

// Returns 2^n exactly; exp2 may be inexact.
float power_of_two(int n) { return uintBitsToFloat(uint(n + 127) << 23u); }

uint pack_rgb9e5(vec3 color) {
    vec3 c = clamp(color, 0.0, RGB9E5_MAX);
    float largest = max_component(c);
    // floor(log2(largest)) from its bits, which is exact; denormals end at the smallest exponent as they should
    int exponent = max(-16, int(floatBitsToUint(largest) >> 23u) - 127) + 16;
    float scale = power_of_two(24 - exponent);
    if (uint(largest * scale + 0.5) == 512u) {
        exponent += 1;
        scale *= 0.5;
    }
    uvec3 mantissa = uvec3(c * scale + 0.5);
    return mantissa.x | mantissa.y << 9u | mantissa.z << 18u | uint(exponent) << 27u;
}

vec3 unpack_rgb9e5(uint bits) {
    vec3 mantissa = vec3(uvec3(bits, bits >> 9u, bits >> 18u) & 0x1FFu);
    return mantissa * power_of_two(int(bits >> 27u) - 24);
}

// Radiance as log2(1 + radiance * exposure), which keeps the energy of dark colors ("Solari", Bevy 0.18 post).
uint pack_radiance_log2_rgb9e5(vec3 radiance, float exposure) {
    return pack_rgb9e5(log2(radiance * exposure + 1.0));
}

vec3 unpack_radiance_log2_rgb9e5(uint bits, float exposure) {
    return (exp2(unpack_rgb9e5(bits)) - 1.0) / exposure;
}

#endif
