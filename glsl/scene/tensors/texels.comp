// Writes a tensor's pixels (height, width), (height, width, 3) or (height, width, 4) as RGBA with 8 bits per channel.
// Texels with a wrong number stay as they are.
#version 460
#include "scene/tensors/numbers.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(push_constant, scalar) uniform Work {
    Floats floats;
    Doubles doubles;  // the same memory
    Words words;      // the same memory, of bytes
    Wrong wrong;
    Words target;
    uint is_double;
    uint is_bytes;
    uint first_byte;  // of the first word
    uint what;
    uint channels;
    uint width;
    uint height;
} work;

const uint ONE = 0x3F800000u;  // the bits of 1.0: those of numbers below it are smaller
const uint MINUS_ZERO = 0x80000000u;

uint code_at(uint at, inout bool right) {
    if (work.is_bytes != 0u) {
        uint byte = at + work.first_byte;
        return work.words.at[byte / 4u] >> 8u * (byte % 4u) & 0xFFu;
    }
    float number = work.is_double != 0u ? float(work.doubles.at[at]) : work.floats.at[at];
    uint bits = floatBitsToUint(number);
    right = right && (bits <= ONE || bits == MINUS_ZERO);
    return uint(roundEven(number * 255.0));
}

void main() {
    uvec2 texel = gl_GlobalInvocationID.xy;
    if (texel.x >= work.width || texel.y >= work.height) { return; }
    uint index = texel.y * work.width + texel.x, first = index * work.channels;
    bool right = true;
    uint red = code_at(first, right), code = red * 0x010101u | 0xFF000000u;
    if (work.channels > 1u) {
        uint alpha = work.channels == 4u ? code_at(first + 3u, right) : 0xFFu;
        code = red | code_at(first + 1u, right) << 8u | code_at(first + 2u, right) << 16u | alpha << 24u;
    }
    if (right) {
        work.target.at[index] = code;
    } else {
        work.wrong.at[0] = wrong_thing(work.what, index);
    }
}
