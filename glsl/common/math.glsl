// Constants and small functions for all shaders.
#ifndef COMMON_MATH_GLSL
#define COMMON_MATH_GLSL

#include "generated/base/color.glsl"  // LUMINANCE_WEIGHTS, written by solari_vk/base/color.py

const float PI = 3.14159265358979;
const float INVERSE_PI = 0.318309886183791;
const float INFINITY = 1.0 / 0.0;
const float ROUNDING_UNIT = 5.9604644775390625e-8;  // 2^-24, the largest relative error of a rounded float

float saturate(float x) { return clamp(x, 0.0, 1.0); }
float square(float x) { return x * x; }
float safe_sqrt(float x) { return sqrt(max(x, 0.0)); }
float max_component(vec3 v) { return max(v.x, max(v.y, v.z)); }
float luminance(vec3 color) { return dot(color, LUMINANCE_WEIGHTS); }
bool is_finite_color(vec3 color) { return !any(isnan(color)) && !any(isinf(color)); }

// Returns v normalized, or the fallback where v has no direction. Scales v first, so that squares neither underflow nor
// overflow.
vec3 safe_normalize(vec3 v, vec3 fallback) {
    float scale = max_component(abs(v));
    return scale > 0.0 && scale < INFINITY ? normalize(v / scale) : fallback;
}

// A right-handed basis with the given z axis: Duff et al., "Building an Orthonormal Basis, Revisited" (JCGT 2017).
mat3 orthonormalize(vec3 z_basis) {
    float z_sign = z_basis.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (z_sign + z_basis.z);
    float b = z_basis.x * z_basis.y * a;
    vec3 x_basis = vec3(1.0 + z_sign * z_basis.x * z_basis.x * a, z_sign * b, -z_sign * z_basis.x);
    vec3 y_basis = vec3(b, z_sign + z_basis.y * z_basis.y * a, -z_basis.y);
    return mat3(x_basis, y_basis, z_basis);
}

// The weights of Catmull-Rom splines at a share of the way from the second of four points to the third.
vec4 catmull_rom_weights(float t) {
    return 0.5 * vec4(((2.0 - t) * t - 1.0) * t, (3.0 * t - 5.0) * t * t + 2.0, ((4.0 - 3.0 * t) * t + 1.0) * t,
                      (t - 1.0) * t * t);
}

// f / (f + g), correct for infinite f or g too.
float balance_heuristic(float f, float g) {
    if (f == 0.0) { return 0.0; }
    return f == g ? 0.5 : 1.0 / (1.0 + g / f);
}

// f^2 / (f^2 + g^2), correct where f, g or their squares are infinite too.
float power_heuristic(float f, float g) {
    if (f == 0.0) { return 0.0; }
    return f == g ? 0.5 : 1.0 / (1.0 + square(g / f));
}

#endif
