// Textures in buffers, for devices whose shaders have no arrays of textures. Filtered as by samplers: Vulkan 1.3,
// "Image Sample Operations".
#ifndef SCENE_TEXEL_BUFFERS_GLSL
#define SCENE_TEXEL_BUFFERS_GLSL

#include "scene/lights/types.glsl"  // Words

const uint WRAP_REPEAT = 0u;
const uint WRAP_MIRROR = 1u;  // 2: clamped to the edge

// A coordinate near the image, which has 0 to 1: within its next turn, or two turns where every other one is mirrored.
float turned(float u, uint wrap) {
    if (wrap == WRAP_REPEAT) { return u - floor(u); }
    return wrap == WRAP_MIRROR ? u - 2.0 * floor(0.5 * u) : clamp(u, -1.0, 2.0);
}

int wrapped(int at, int size, uint wrap) {
    if (wrap == WRAP_REPEAT) { at += at < 0 ? size : at >= size ? -size : 0; }
    if (wrap == WRAP_MIRROR && at >= size) { at = 2 * size - 1 - at; }
    return clamp(at, 0, size - 1);
}

// begin: of the level's texels.
vec4 texel_in(Texture image, uint begin, ivec2 size, ivec2 at) {
    int x = wrapped(at.x, size.x, image.wrap.x), y = wrapped(at.y, size.y, image.wrap.y);
    vec4 texel = unpackUnorm4x8(Words(image.texels).at[begin + uint(y * size.x + x)]);
    if (image.is_srgb != 0u) {
        // IEC 61966-2-1. Colors are filtered as light.
        vec3 curve = pow((texel.rgb + 0.055) / 1.055, vec3(2.4));
        texel.rgb = mix(curve, texel.rgb / 12.92, lessThanEqual(texel.rgb, vec3(0.04045)));
    }
    return texel;
}

vec4 filtered_level(Texture image, uint begin, ivec2 size, vec2 uv, bool is_linear) {
    vec2 at = uv * vec2(size) - (is_linear ? 0.5 : 0.0);
    vec2 nearness = is_linear ? fract(at) : vec2(0.0);
    vec4 sum = vec4(0.0);
    // Loops, because compilers take long for copies at each place that samples.
    for (uint corner = 0u; corner < 4u; corner++) {
        ivec2 offset = ivec2(corner & 1u, corner >> 1u);
        vec2 part = mix(1.0 - nearness, nearness, equal(offset, ivec2(1)));
        float weight = part.x * part.y;
        if (weight > 0.0) { sum += weight * texel_in(image, begin, size, ivec2(floor(at)) + offset); }
    }
    return sum;
}

vec4 sample_texels(Texture image, vec2 uv, float lod) {
    bool is_linear = (lod <= 0.0 ? image.magnifies_linearly : image.minifies_linearly) != 0u;
    float level = clamp(lod, 0.0, float(image.level_count - 1u));
    vec2 turned_uv = vec2(turned(uv.x, image.wrap.x), turned(uv.y, image.wrap.y));
    ivec2 size = image.size;
    uint begin = 0u;
    vec4 sum = vec4(0.0);
    for (uint current = 0u; float(current) < level + 1.0; current++) {
        float weight = 1.0 - abs(float(current) - level);
        if (weight > 0.0) { sum += weight * filtered_level(image, begin, size, turned_uv, is_linear); }
        begin += uint(size.x * size.y);
        size = max(size / 2, ivec2(1));
    }
    return sum;
}

#endif
