// From radiance to what an 8-bit picture holds: exposure, the curves of solari_vk/output/picture.py, which names their sources, and sRGB.
#ifndef PASSES_DISPLAY_TONEMAP_GLSL
#define PASSES_DISPLAY_TONEMAP_GLSL

#include "common/math.glsl"
#include "passes/bindings.glsl"

// uniforms.tonemap
const uint TONEMAP_NONE = 0u;
const uint TONEMAP_REINHARD = 1u;
const uint TONEMAP_ACES = 2u;
const uint TONEMAP_AGX = 3u;

vec3 map_reinhard(vec3 color) { return color / (1.0 + luminance(color)); }

vec3 map_aces(vec3 color) {
    vec3 x = 0.6 * color;
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
}

const mat3 AGX_INSET = mat3(  // by rows
    0.842479062253094, 0.0784335999999992, 0.0792237451477643,
    0.0423282422610123, 0.878468636469772, 0.0791661274605434,
    0.0423756549057051, 0.0784336, 0.879142973793104
);
const vec2 AGX_STOPS = vec2(-12.47393, 4.026069);  // lowest and highest

vec3 map_agx(vec3 color) {
    vec3 stops = log2(max(color * AGX_INSET, 1e-10));
    vec3 x = clamp((stops - AGX_STOPS.x) / (AGX_STOPS.y - AGX_STOPS.x), 0.0, 1.0);
    vec3 shaped = (((((15.5 * x - 40.14) * x + 31.96) * x - 6.868) * x + 0.4298) * x + 0.1191) * x - 0.00232;
    return pow(clamp(shaped * inverse(AGX_INSET), 0.0, 1.0), vec3(2.2));
}

vec3 tonemap(vec3 exposed) {
    vec3 color = mix(clamp(exposed, 0.0, 1e6), vec3(0.0), isnan(exposed));
    if (uniforms.tonemap == TONEMAP_REINHARD) { color = map_reinhard(color); }
    if (uniforms.tonemap == TONEMAP_ACES) { color = map_aces(color); }
    if (uniforms.tonemap == TONEMAP_AGX) { color = map_agx(color); }
    return clamp(color, 0.0, 1.0);
}

vec3 encode_srgb(vec3 linear) {
    return mix(1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, 12.92 * linear, lessThanEqual(linear, vec3(0.0031308)));
}

// As the picture shows it.
vec3 show_radiance(vec3 radiance) { return encode_srgb(tonemap(radiance * uniforms.exposure)); }

#endif
