// How alike the surfaces of two pixels are, as weights of a filter.
#ifndef PASSES_DENOISE_LIKENESS_GLSL
#define PASSES_DENOISE_LIKENESS_GLSL

#include "passes/denoise/guide.glsl"

const float PLANE_TOLERANCE = 1.0;           // distance from the surface's plane, in widths of a pixel
const float DIFFUSE_NORMAL_TOLERANCE = 0.06; // 1 - the cosine between normals
const float MIRROR_NORMAL_TOLERANCE = 0.05;  // the same for surfaces seen in mirrors
const float SPECULAR_NORMAL_TOLERANCE = 0.1; // the same for the specular lobe, over its squared roughness
// The least squared roughness that counts, for certain light and for uncertain light: it is better to blur reflections
// of smooth surfaces a little than to show their noise.
const float CERTAIN_ALPHA = 0.003, UNCERTAIN_ALPHA = 0.04;
const float MATERIAL_TOLERANCE = 0.1;

// What other pixels are compared with.
struct Pattern {
    Guide guide;
    // A pixel that is x, y away and d deep is d * dot(plane, (x, y, 1)) - plane_offset tolerances off the plane.
    vec3 plane;
    float plane_offset;
    vec2 normal_sharpness;  // 1 / tolerance for the diffuse and for the specular lobe
};

// uncertainty: the standard deviation of the light by the specular lobe over its mean.
Pattern make_pattern(Guide guide, float uncertainty) {
    vec2 slopes = 2.0 * camera.tan_half_fov * vec2(1.0, -1.0) / vec2(camera.size);
    vec3 normal = guide.normal / (PLANE_TOLERANCE * pixel_width() * guide.depth);
    vec3 in_view = normal * mat3(camera.world_from_view);
    float offset = dot(guide.position, normal);
    float alpha = max(guide.material * guide.material, mix(CERTAIN_ALPHA, UNCERTAIN_ALPHA, min(uncertainty, 1.0)));
    bool reflected = guide.kind != SURFACE_SHOWN;
    float tolerance = reflected ? MIRROR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * alpha;
    return Pattern(
        guide, vec3(in_view.xy * slopes, offset / guide.depth), offset,
        1.0 / vec2(DIFFUSE_NORMAL_TOLERANCE, tolerance)
    );
}

// The weights for the diffuse and for the specular lobe of the pixel that is `step` away.
vec2 likeness(Pattern pattern, uvec2 other, ivec2 step) {
    if (kind_of(other) != pattern.guide.kind) { return vec2(0.0); }
    float off = abs(uintBitsToFloat(other.y) * dot(pattern.plane, vec3(step, 1.0)) - pattern.plane_offset);
    float turned = 1.0 - min(dot(pattern.guide.normal, unpack_octahedral_24(other.x & 0xFFFFFFu)), 1.0);
    float unlike = abs(pattern.guide.material - unpack_unorm(other.x >> 24u, 6u)) / MATERIAL_TOLERANCE;
    return exp(-(off + turned * pattern.normal_sharpness + vec2(0.0, unlike)));
}

#endif
