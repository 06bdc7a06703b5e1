// Camera rays and the filters that spread a pixel's samples.
#ifndef PASSES_PATHTRACER_CAMERA_GLSL
#define PASSES_PATHTRACER_CAMERA_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"

struct CameraRay {
    vec3 origin;
    vec3 direction;
    float t_min;           // at the near plane
    float depth_per_t;     // depth along the view axis of a step along the ray
    float cone_spread;     // how fast a pixel's footprint widens
};

CameraRay make_camera_ray(vec2 pixel_position) {
    vec2 ndc = 2.0 * (pixel_position + uniforms.jitter) / vec2(uniforms.size) - 1.0;
    vec3 view_direction = vec3(ndc * uniforms.tan_half_fov * vec2(1.0, -1.0), -1.0);
    float slant = length(view_direction);
    CameraRay ray;
    ray.origin = uniforms.world_from_view[3];
    ray.direction = normalize(mat3(uniforms.world_from_view) * view_direction);
    ray.t_min = uniforms.near * slant;
    ray.depth_per_t = 1.0 / slant;
    // a pixel's height at distance 1 shrinks with the square of the slant towards the picture's edge
    ray.cone_spread = 2.0 * uniforms.tan_half_fov.y / (float(uniforms.size.y) * slant * slant);
    return ray;
}

// Where the integral of the window 0.35875 + 0.48829 cos + 0.14128 cos 2 + 0.01168 cos 3 over [-1, 1] reaches u.
float sample_blackman_harris(float u) {
    float low = -1.0, high = 1.0, x = 0.5 * (u - 0.5);
    for (uint i = 0u; i < 12u; i++) {
        vec3 angle = PI * x * vec3(1.0, 2.0, 3.0);
        float integral = 0.5 * (x + 1.0)
            + dot(vec3(0.48829, 0.14128, 0.01168) / vec3(1.0, 2.0, 3.0), sin(angle)) * (0.5 * INVERSE_PI / 0.35875);
        float density = 0.5 * (1.0 + dot(vec3(0.48829, 0.14128, 0.01168), cos(angle)) / 0.35875);
        if (integral < u) { low = x; } else { high = x; }
        x -= (integral - u) / max(density, 1e-3);
        x = x > low && x < high ? x : 0.5 * (low + high);
    }
    return x;
}

// An offset from the pixel's centre, in pixels, with the filter as its density: so all samples weigh the same.
vec2 sample_pixel_filter(vec2 u) {
    float radius = uniforms.filter_radius;
    if (uniforms.pixel_filter == PIXEL_FILTER_GAUSSIAN) {
        // cut off at 4 standard deviations
        float angle = 2.0 * PI * u.y;
        return 0.25 * radius * sqrt(-2.0 * log(1.0 - u.x * (1.0 - exp(-8.0)))) * vec2(cos(angle), sin(angle));
    }
    if (uniforms.pixel_filter == PIXEL_FILTER_BLACKMAN_HARRIS) {
        return radius * vec2(sample_blackman_harris(u.x), sample_blackman_harris(u.y));
    }
    return radius * (2.0 * u - 1.0);
}

#endif
