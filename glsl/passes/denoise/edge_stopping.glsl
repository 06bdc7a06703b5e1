// Edge-stopping functions: how alike the surfaces of two pixels are, as weights of a filter.
#ifndef PASSES_DENOISE_EDGE_STOPPING_GLSL
#define PASSES_DENOISE_EDGE_STOPPING_GLSL

#include "passes/denoise/guide.glsl"

// What other pixels are compared with.
struct EdgeStopping {
    uint kind;
    // The surface's plane, in units of PLANE_TOLERANCE pixel widths. A pixel that is x, y away and d deep is d *
    // dot(plane, (x, y, 1)) - plane_offset tolerances off the plane; in parallel projections dot(plane, (x, y, d)) -
    // plane_offset. Wide lenses divide the product by sqrt(1 + dot(squared_pixel_angle, (x^2, y^2))).
    vec3 plane;
    vec2 squared_pixel_angle;               // the square of the angle between neighboring pixels
    float plane_offset;
    vec3 normal;             // as quantized_normal gives it
    float roughness_or_albedo;  // as quantized_roughness_or_albedo gives it
    vec2 normal_sharpness;   // factor of the squared difference of normals, by lobe (diffuse, specular)
};

// relative_error: of the light by the specular lobe, its standard error over its mean, or before that is known one over
// the square root of the number of frames. min_alpha_if_uncertain: the least alpha (squared perceptual roughness) that
// counts where relative_error is 1 or more.
EdgeStopping make_edge_stopping(Guide guide, ivec2 pixel, float relative_error, float min_alpha_if_uncertain) {
    vec2 slopes = 2.0 * camera.tan_half_fov * vec2(1.0, -1.0) / vec2(camera.size);
    vec3 normal = guide.normal / (PLANE_TOLERANCE * pixel_width(guide.depth));
    vec3 in_view = normal * mat3(camera.world_from_view);
    float offset = dot(guide.position, normal);
    float min_alpha = mix(MIN_ALPHA_CONVERGED, min_alpha_if_uncertain, min(relative_error, 1.0));
    float alpha = max(guide.roughness_or_albedo * guide.roughness_or_albedo, min_alpha);
    bool is_psr = guide.kind != PRIMARY_SURFACE;
    float tolerance = is_psr ? MIRROR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * alpha;
    float per_depth = offset / guide.depth;
    if (is_parallel(camera)) {
        per_depth = -in_view.z;
        offset = per_depth * guide.depth;
    }
    vec3 plane = vec3(in_view.xy * slopes, per_depth);
    vec2 squared_pixel_angle = vec2(0.0);
    if (has_lens(camera)) {
        vec2 at = vec2(pixel) + 0.5 + camera.jitter;
        vec3 along = view_line(at, camera).along;
        // The next pixel of a cube may be on another face.
        vec2 x = 2.0 * camera.tan_half_fov.x * (vec2(at.x, at.x + 1.0) / float(camera.size.x) - 0.5);
        float side = camera.lens.kind == CUBE && cube_face_at(x[0]) != cube_face_at(x[1]) ? -1.0 : 1.0;
        vec3 across = side * (view_line(at + vec2(side, 0.0), camera).along - along);
        vec3 down = view_line(at + vec2(0.0, 1.0), camera).along - along;
        plane.xy = in_view * mat2x3(across, down);
        squared_pixel_angle = vec2(dot(across, across), dot(down, down));
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
    float plane_coordinate = is_parallel(camera)
        ? dot(edges.plane, vec3(step, depth))
        : depth * dot(edges.plane, vec3(step, 1.0));
    if (is_wide(camera)) { plane_coordinate *= inversesqrt(1.0 + dot(edges.squared_pixel_angle, vec2(step * step))); }
    vec3 normal_difference = quantized_normal(other) - edges.normal;
    // How far a surface as curved as the normals say lies off its plane there.
    float sagitta = 0.5 * length(normal_difference) / NORMAL_SCALE * length(vec2(step)) / PLANE_TOLERANCE;
    float plane_distance = max(abs(plane_coordinate - edges.plane_offset) - sagitta, 0.0);
    float material_difference = abs(quantized_roughness_or_albedo(other) - edges.roughness_or_albedo)
        / (MATERIAL_TOLERANCE * MATERIAL_SCALE);
    vec2 weights = exp(-(plane_distance + dot(normal_difference, normal_difference) * edges.normal_sharpness
        + vec2(0.0, material_difference)));
    return kind_of(other) == edges.kind ? weights : vec2(0.0);
}

#endif
