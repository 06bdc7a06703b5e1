// What a pixel shows of lights themselves.
#ifndef PASSES_DISPLAY_EMISSION_GLSL
#define PASSES_DISPLAY_EMISSION_GLSL

#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "scene/sampling.glsl"

vec3 visible_emission(uvec2 pixel) {
    vec3 emitted = unpack_emissive(imageLoad(gbuffer, ivec2(pixel)));
    if (imageLoad(depth, ivec2(pixel)).x == 0.0) {
        emitted += radiance_at_infinity(make_camera_ray(vec2(pixel) + 0.5).direction, INFINITY);
    }
    return emitted;
}

#endif
