// Averages a level of an image to the next one, in the order of solari_vk/scene/images/mip_chain.py, so that it has the
// same bits.
#version 460
#include "scene/tensors/numbers.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(buffer_reference, scalar, buffer_reference_align = 16) buffer Lights { vec4 at[]; };

layout(push_constant, scalar) uniform Work {
    Words codes;          // of the largest level, which has no `source`
    Lights source;        // what is averaged
    Lights target;
    Words target_codes;
    Floats light_of_code; // of sRGB
    Words code_of_light;  // bytes
    uint width;           // of the source
    uint height;
    uint is_first;        // after the largest level
    uint is_srgb;
} work;

vec4 light_at(uint x, uint y) {
    uint index = y * work.width + x;
    if (work.is_first == 0u) { return work.source.at[index]; }
    uvec4 codes = uvec4(work.codes.at[index]) >> uvec4(0u, 8u, 16u, 24u) & 0xFFu;
    vec4 light = vec4(codes);
    if (work.is_srgb != 0u) {
        for (uint i = 0u; i < 3u; i++) { light[i] = work.light_of_code.at[codes[i]]; }
    }
    return light;
}

// The average of the texels 2 * index and 2 * index + 1 of `size`; of an odd size also of the next one.
vec4 average(vec4 even, vec4 odd, vec4 next, uint index, uint size) {
    precise vec4 sum, result;
    if (size % 2u == 0u) {
        sum = even + odd;
        result = sum * 0.5;
        return result;
    }
    float half_size = float(size / 2u);
    sum = even * (half_size - float(index)) + odd * half_size + next * float(index + 1u);
    for (uint i = 0u; i < 4u; i++) { result[i] = float(double(sum[i]) / double(size)); }  // rounded as by IEEE 754
    return result;
}

vec4 average_of_rows(uint x, uint row) {
    if (work.height == 1u) { return light_at(x, 0u); }
    uint y = 2u * row;
    vec4 next = work.height % 2u == 0u ? vec4(0.0) : light_at(x, y + 2u);
    return average(light_at(x, y), light_at(x, y + 1u), next, row, work.height);
}

void main() {
    uvec2 size = max(uvec2(work.width, work.height) / 2u, uvec2(1u)), texel = gl_GlobalInvocationID.xy;
    if (texel.x >= size.x || texel.y >= size.y) { return; }
    uint x = 2u * texel.x;
    precise vec4 light = average_of_rows(work.width == 1u ? 0u : x, texel.y);
    if (work.width > 1u) {
        vec4 next = work.width % 2u == 0u ? vec4(0.0) : average_of_rows(x + 2u, texel.y);
        light = average(light, average_of_rows(x + 1u, texel.y), next, texel.x, work.width);
    }
    uint index = texel.y * size.x + texel.x;
    work.target.at[index] = light;
    precise vec4 rounded = light + 0.5;
    uvec4 codes = uvec4(rounded);
    if (work.is_srgb != 0u) {
        for (uint i = 0u; i < 3u; i++) {
            codes[i] = work.code_of_light.at[codes[i] / 4u] >> 8u * (codes[i] % 4u) & 0xFFu;
        }
    }
    work.target_codes.at[index] = codes.r | codes.g << 8u | codes.b << 16u | codes.a << 24u;
}
