// Where the previous frame showed what a surface reflects: Zhdan, "ReBLUR" (2021).
#ifndef PASSES_DENOISE_VIRTUAL_MOTION_GLSL
#define PASSES_DENOISE_VIRTUAL_MOTION_GLSL

#include "passes/denoise/previous_frame.glsl"

const float MIN_VIEW_CHANGE = 1e-6;

// The direction from a camera to a position relative to it.
vec3 view_direction(vec3 position, Camera from) {
    return is_orthographic(from) ? -from.world_from_view[2] : normalize(position);
}

// How much the direction has changed from which a surface is seen; below MIN_VIEW_CHANGE it is rounding.
float view_change(Guide guide, PreviousSurface previous) {
    return length(view_direction(guide.position, camera) - view_direction(previous.position, previous_camera));
}

// The mean curvature of the surface along both axes of the picture, in 1/m; positive if convex. An axis along which
// the neighbor shows another surface, or the same normal, counts as flat.
float curvature(ivec2 pixel, Guide guide) {
    float sum = 0.0;
    for (int i = 0; i < 2; i++) {
        ivec2 step = i == 0 ? ivec2(1, 0) : ivec2(0, 1);
        ivec2 other = pixel + (any(greaterThanEqual(pixel + step, ivec2(camera.size))) ? -step : step);
        if (any(lessThan(other, ivec2(0)))) { continue; }
        Guide next = make_guide(other);
        vec3 offset = next.position - guide.position, normal_change = next.normal - guide.normal;
        bool same = next.kind == guide.kind && dot(normal_change, normal_change) < MAX_CURVED_NORMALS
            && dot(normal_change, normal_change) > MIN_CURVED_NORMALS;
        if (same) { sum += 0.5 * dot(normal_change, offset) / dot(offset, offset); }
    }
    return sum;
}

// The pixel of the previous frame that showed the virtual image of light from 1 / inverse_hit_distance meters away.
// Returns false where a curved mirror shows none.
bool find_virtual_pixel(
    ivec2 pixel, Guide guide, PreviousSurface previous, float inverse_hit_distance, float twice_curvature,
    out vec2 virtual_pixel
) {
    vec3 direction = view_direction(guide.position, camera);
    float cosine = max(-dot(direction, guide.normal), 0.1);
    // The mirror equation: where a curved mirror shows the virtual image.
    float inverse_distance = inverse_hit_distance + twice_curvature / cosine;
    if (!(inverse_distance > 0.0)) { return false; }
    vec3 virtual_offset = direction / inverse_distance;
    virtual_pixel = previous_pixel(guide.position + virtual_offset, previous.position + virtual_offset, pixel);
    return true;
}

#endif
