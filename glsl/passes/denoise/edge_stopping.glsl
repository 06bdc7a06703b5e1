// Edge-stopping functions: how alike the surfaces of two pixels are, as weights of a filter.
#ifndef PASSES_DENOISE_EDGE_STOPPING_GLSL
#define PASSES_DENOISE_EDGE_STOPPING_GLSL

#include "passes/denoise/guide.glsl"

// What other pixels are compared with.
struct EdgeStopping {
    uint kind;
    // The tangent plane. What the pixel (x, y) away shows at the depth d has this distance from it, in units of
    // PLANE_TOLERANCE pixel widths: d * dot(plane, (x, y, 1)) - plane_offset; in orthographic projections
    // dot(plane, (x, y, d)) - plane_offset. Lenses whose depth is measured along the ray (is_wide) divide the product
    // by the length of the pixel's unnormalized ray, about sqrt(1 + dot(squared_pixel_angle, (x^2, y^2))).
    vec3 plane;
    vec2 squared_pixel_angle;  // of the angles between the rays of neighboring pixels, in x and in y
    float plane_offset;
    vec3 normal;                // as quantized_normal gives it
    float roughness_or_albedo;  // as quantized_roughness_or_albedo gives it
    vec2 normal_sharpness;      // factor of the squared difference of normals, by lobe (diffuse, specular)
};

// relative_error: the standard error of the specular lobe's light over its mean; while that is unknown,
// 1 / sqrt(history length). min_alpha_if_noisy: surfaces with less alpha (squared perceptual roughness) count
// as if they had this where relative_error is 1 or more.
EdgeStopping make_edge_stopping(Guide guide, ivec2 pixel, float relative_error, float min_alpha_if_noisy) {
    vec2 slopes = 2.0 * camera.tan_half_fov * vec2(1.0, -1.0) / vec2(camera.size);
    vec3 normal = guide.normal / (PLANE_TOLERANCE * pixel_width(guide.depth));
    vec3 view_normal = normal * mat3(camera.world_from_view);
    float offset = dot(guide.position, normal);
    float min_alpha = mix(MIN_ALPHA_CONVERGED, min_alpha_if_noisy, min(relative_error, 1.0));
    float alpha = max(guide.roughness_or_albedo * guide.roughness_or_albedo, min_alpha);
    bool is_psr = guide.kind != PRIMARY_SURFACE;
    float tolerance = is_psr ? PSR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * alpha;
    float offset_per_depth = offset / guide.depth;
    if (is_orthographic(camera)) {
        offset_per_depth = -view_normal.z;
        offset = offset_per_depth * guide.depth;
    }
    vec3 plane = vec3(view_normal.xy * slopes, offset_per_depth);
    vec2 squared_pixel_angle = vec2(0.0);
    if (has_lens(camera)) {
        // Not a pinhole: differences to the rays of the pixels to the right and below. In a cube map the pixel to the
        // right may be on another face; then the one to the left is taken.
        vec2 position = vec2(pixel) + 0.5 + camera.jitter;
        vec3 direction = view_ray(position, camera).direction;
        vec2 x = 2.0 * camera.tan_half_fov.x * (vec2(position.x, position.x + 1.0) / float(camera.size.x) - 0.5);
        float side = camera.lens.kind == CUBE && cube_face_at(x[0]) != cube_face_at(x[1]) ? -1.0 : 1.0;
        vec3 ddx = side * (view_ray(position + vec2(side, 0.0), camera).direction - direction);
        vec3 ddy = view_ray(position + vec2(0.0, 1.0), camera).direction - direction;
        plane.xy = view_normal * mat2x3(ddx, ddy);
        squared_pixel_angle = vec2(dot(ddx, ddx), dot(ddy, ddy));
    }
    return EdgeStopping(
        guide.kind, plane, squared_pixel_angle, offset, NORMAL_SCALE * guide.normal,
        MATERIAL_SCALE * guide.roughness_or_albedo,
        0.5 / (NORMAL_SCALE * NORMAL_SCALE * vec2(DIFFUSE_NORMAL_TOLERANCE, tolerance))
    );
}

// The weights for the diffuse and for the specular lobe of the pixel that is `step` away.
vec2 edge_stopping_weights(EdgeStopping edges, uvec2 other, ivec2 step) {
    float depth = depth_of(other);
    float plane_coordinate = is_orthographic(camera)
        ? dot(edges.plane, vec3(step, depth))
        : depth * dot(edges.plane, vec3(step, 1.0));
    if (is_wide(camera)) { plane_coordinate *= inversesqrt(1.0 + dot(edges.squared_pixel_angle, vec2(step * step))); }
    vec3 normal_difference = quantized_normal(other) - edges.normal;
    // How far a curved surface with these two normals lies off its tangent plane there.
    float sagitta = 0.5 * length(normal_difference) / NORMAL_SCALE * length(vec2(step)) / PLANE_TOLERANCE;
    float plane_distance = max(abs(plane_coordinate - edges.plane_offset) - sagitta, 0.0);
    float material_difference = abs(quantized_roughness_or_albedo(other) - edges.roughness_or_albedo)
        / (MATERIAL_TOLERANCE * MATERIAL_SCALE);
    vec2 weights = exp(-(plane_distance + dot(normal_difference, normal_difference) * edges.normal_sharpness
        + vec2(0.0, material_difference)));
    return kind_of(other) == edges.kind ? weights : vec2(0.0);
}

#endif
