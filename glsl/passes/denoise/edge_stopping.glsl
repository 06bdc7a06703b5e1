// How alike the surfaces of two pixels are, as weights of a filter.
#ifndef PASSES_DENOISE_EDGE_STOPPING_GLSL
#define PASSES_DENOISE_EDGE_STOPPING_GLSL

#include "passes/denoise/guide.glsl"

// What other pixels are compared with.
struct EdgeStopping {
    uint kind;
    // A pixel that is x, y away and d deep is d * dot(plane, (x, y, 1)) - plane_offset tolerances off the plane; in
    // parallel projections dot(plane, (x, y, d)) - plane_offset.
    vec3 plane;
    float plane_offset;
    vec3 normal;             // as normal_code gives it
    float material;          // as material_code gives it
    vec2 normal_sharpness;   // by the squared difference of normals, for the diffuse and for the specular lobe
};

// uncertainty: the standard deviation of the light by the specular lobe over its mean. widest: the least squared
// roughness where it is 1 or more.
EdgeStopping make_edge_stopping(Guide guide, float uncertainty, float widest) {
    vec2 slopes = 2.0 * camera.tan_half_fov * vec2(1.0, -1.0) / vec2(camera.size);
    vec3 normal = guide.normal / (PLANE_TOLERANCE * pixel_width(guide.depth));
    vec3 in_view = normal * mat3(camera.world_from_view);
    float offset = dot(guide.position, normal);
    float alpha = max(guide.material * guide.material, mix(CERTAIN_ALPHA, widest, min(uncertainty, 1.0)));
    bool reflected = guide.kind != SURFACE_SHOWN;
    float tolerance = reflected ? MIRROR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * alpha;
    float per_depth = offset / guide.depth;
    if (is_parallel(camera)) {
        per_depth = -in_view.z;
        offset = per_depth * guide.depth;
    }
    return EdgeStopping(
        guide.kind, vec3(in_view.xy * slopes, per_depth), offset, NORMAL_CODES * guide.normal,
        MATERIAL_CODES * guide.material,
        0.5 / (NORMAL_CODES * NORMAL_CODES * vec2(DIFFUSE_NORMAL_TOLERANCE, tolerance))
    );
}

// The weights for the diffuse and for the specular lobe of the pixel that is `step` away.
vec2 edge_stopping_weights(EdgeStopping edges, uvec2 other, ivec2 step) {
    float depth = depth_of(other);
    float along = is_parallel(camera)
        ? dot(edges.plane, vec3(step, depth))
        : depth * dot(edges.plane, vec3(step, 1.0));
    vec3 turned = normal_code(other) - edges.normal;
    float bend = 0.5 * length(turned) / NORMAL_CODES * length(vec2(step)) / PLANE_TOLERANCE;
    float off = max(abs(along - edges.plane_offset) - bend, 0.0);
    float normal_divergence = abs(material_code(other) - edges.material) / (MATERIAL_TOLERANCE * MATERIAL_CODES);
    vec2 weights = exp(-(off + dot(turned, turned) * edges.normal_sharpness + vec2(0.0, normal_divergence)));
    return kind_of(other) == edges.kind ? weights : vec2(0.0);
}

#endif
