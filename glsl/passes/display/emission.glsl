// What a pixel shows of lights themselves.
#ifndef PASSES_DISPLAY_EMISSION_GLSL
#define PASSES_DISPLAY_EMISSION_GLSL

#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "scene/sampling.glsl"

// The light of lights in the medium of the camera.
vec3 visible_emission(uvec2 pixel, Medium medium) {
    vec3 emitted = unpack_emissive(imageLoad(gbuffer, texel_of(pixel)));
    if (!is_seen(vec2(pixel) + 0.5)) { return vec3(0.0); }
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    float inverse_depth = imageLoad(depth, texel_of(pixel)).x / camera.near;
    float t = inverse_depth > 0.0 ? 1.0 / (inverse_depth * ray.depth_per_t) : INFINITY;
    emitted *= transmittance(medium, t);
    emitted += mis_weighted_radiance_along_ray(ray.origin, ray.direction, t, INFINITY, medium);
    if (inverse_depth == 0.0) {
        vec3 background = mis_weighted_radiance_at_infinity(ray.direction, INFINITY, NO_RECEIVER);
        emitted += background * transmittance(medium, INFINITY);
    }
    return emitted;
}

#endif
