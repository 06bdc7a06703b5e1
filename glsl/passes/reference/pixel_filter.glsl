// Pixel filters: how the samples of a pixel spread around its center.
#ifndef PASSES_REFERENCE_PIXEL_FILTER_GLSL
#define PASSES_REFERENCE_PIXEL_FILTER_GLSL

#include "common/math.glsl"
#include "passes/reference/bindings.glsl"

// Inverts the normalized integral of the Blackman-Harris window 0.35875 + 0.48829 cos(pi x) + 0.14128 cos(2 pi x)
// + 0.01168 cos(3 pi x) over [-1, 1], by Newton steps that fall back to bisection.
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

// Filter importance sampling: an offset from the pixel's center in pixels with the filter as pdf, so that all samples
// have the same weight.
vec2 sample_pixel_filter(vec2 u) {
    float radius = path_sampling.filter_radius;
    if (path_sampling.pixel_filter == PIXEL_FILTER_GAUSSIAN) {
        // cut off at 4 standard deviations, which is the radius
        float angle = 2.0 * PI * u.y;
        return 0.25 * radius * sqrt(-2.0 * log(1.0 - u.x * (1.0 - exp(-8.0)))) * vec2(cos(angle), sin(angle));
    }
    if (path_sampling.pixel_filter == PIXEL_FILTER_BLACKMAN_HARRIS) {
        return radius * vec2(sample_blackman_harris(u.x), sample_blackman_harris(u.y));
    }
    return radius * (2.0 * u - 1.0);
}

#endif
