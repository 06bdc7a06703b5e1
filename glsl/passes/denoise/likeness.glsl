// How alike the surfaces of two pixels are, as weights of a filter.
#ifndef PASSES_DENOISE_LIKENESS_GLSL
#define PASSES_DENOISE_LIKENESS_GLSL

#include "passes/denoise/guide.glsl"

const float PLANE_TOLERANCE = 1.0;           // distance from the surface's plane, in widths of a pixel
const float DIFFUSE_NORMAL_TOLERANCE = 0.06; // 1 - the cosine between normals
const float MIRROR_NORMAL_TOLERANCE = 0.05;  // the same for surfaces seen in mirrors
const float SPECULAR_NORMAL_TOLERANCE = 0.1; // the same for the specular lobe, over its squared roughness
const float MIN_ALPHA = 0.003;
const float ROUGHNESS_TOLERANCE = 0.1;

// What of a pixel sets its tolerances: 1 / tolerance.
struct Sharpness {
    float plane;
    float diffuse_normal;
    float specular_normal;
};

Sharpness sharpness(Guide guide) {
    float alpha = guide.perceptual_roughness * guide.perceptual_roughness;
    bool reflected = guide.kind != SURFACE_SHOWN;
    return Sharpness(
        1.0 / (PLANE_TOLERANCE * pixel_width() * guide.depth),
        1.0 / DIFFUSE_NORMAL_TOLERANCE,
        1.0 / (reflected ? MIRROR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * max(alpha, MIN_ALPHA))
    );
}

// The weights for the diffuse and for the specular lobe.
vec2 likeness(Guide guide, Sharpness sharp, Guide other) {
    if (other.kind != guide.kind) { return vec2(0.0); }
    float plane = abs(dot(other.position - guide.position, guide.normal)) * sharp.plane;
    float turned = 1.0 - min(dot(guide.normal, other.normal), 1.0);
    float rougher = abs(guide.perceptual_roughness - other.perceptual_roughness) / ROUGHNESS_TOLERANCE;
    return exp(-vec2(plane + turned * sharp.diffuse_normal, plane + turned * sharp.specular_normal + rougher));
}

#endif
