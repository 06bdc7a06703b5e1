// From radiance to the colors of an 8-bit picture: exposure, a tone-mapping curve, sRGB.
// solari_vk/output/tone_mapping.py has the same functions, their sources and their numbers.
#ifndef PASSES_DISPLAY_TONEMAP_GLSL
#define PASSES_DISPLAY_TONEMAP_GLSL

#include "common/math.glsl"
#include "generated/output/tone_mapping.glsl"  // TONEMAP_* and the curves' numbers: solari_vk/output/tone_mapping.py
#include "passes/display/bindings.glsl"

vec3 map_reinhard(vec3 color) { return color / (1.0 + luminance(color)); }

vec3 map_aces(vec3 color) {
    vec3 x = ACES_EXPOSURE * color;
    return x * (ACES_NUMERATOR[0] * x + ACES_NUMERATOR[1])
        / (x * (ACES_DENOMINATOR[0] * x + ACES_DENOMINATOR[1]) + ACES_DENOMINATOR[2]);
}

vec3 map_agx(vec3 color) {
    vec3 stops = log2(max(color * AGX_INSET, 1e-10));
    vec3 x = clamp((stops - AGX_MIN_STOPS) / (AGX_MAX_STOPS - AGX_MIN_STOPS), 0.0, 1.0);
    vec3 shaped = vec3(AGX_CURVE[0]);
    for (int i = 1; i < AGX_CURVE.length(); i++) { shaped = shaped * x + AGX_CURVE[i]; }
    return pow(clamp(shaped * inverse(AGX_INSET), 0.0, 1.0), vec3(AGX_GAMMA));
}

vec3 tonemap(vec3 exposed) {
    vec3 color = mix(clamp(exposed, 0.0, MAX_EXPOSED), vec3(0.0), isnan(exposed));
    switch (display_settings.tonemap) {
        case TONEMAP_REINHARD: color = map_reinhard(color); break;
        case TONEMAP_ACES: color = map_aces(color); break;
        case TONEMAP_AGX: color = map_agx(color); break;
    }
    return clamp(color, 0.0, 1.0);
}

vec3 encode_srgb(vec3 linear) {
    vec3 curved = SRGB_SCALE * pow(linear, vec3(1.0 / SRGB_GAMMA)) - SRGB_OFFSET;
    return mix(curved, SRGB_SLOPE * linear, lessThanEqual(linear, vec3(SRGB_KNEE)));
}

// Radiance in cd/m^2 as the picture shows it.
vec3 show_radiance(vec3 radiance) { return encode_srgb(tonemap(radiance * this_frame.exposure)); }

#endif
