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

// What of a pixel sets its tolerances: 1 / tolerance.
struct Sharpness {
    float plane;
    float diffuse_normal;
    float specular_normal;
};

// uncertainty: the standard deviation of the light by the specular lobe over its mean.
Sharpness sharpness(Guide guide, float uncertainty) {
    float alpha = guide.material * guide.material;
    float least = mix(CERTAIN_ALPHA, UNCERTAIN_ALPHA, min(uncertainty, 1.0));
    bool reflected = guide.kind != SURFACE_SHOWN;
    return Sharpness(
        1.0 / (PLANE_TOLERANCE * pixel_width() * guide.depth),
        1.0 / DIFFUSE_NORMAL_TOLERANCE,
        1.0 / (reflected ? MIRROR_NORMAL_TOLERANCE : SPECULAR_NORMAL_TOLERANCE * max(alpha, least))
    );
}

// The weights for the diffuse and for the specular lobe.
vec2 likeness(Guide guide, Sharpness sharp, Guide other) {
    if (other.kind != guide.kind) { return vec2(0.0); }
    float plane = abs(dot(other.position - guide.position, guide.normal)) * sharp.plane;
    float turned = 1.0 - min(dot(guide.normal, other.normal), 1.0);
    float unlike = abs(guide.material - other.material) / MATERIAL_TOLERANCE;
    return exp(-vec2(plane + turned * sharp.diffuse_normal, plane + turned * sharp.specular_normal + unlike));
}

#endif
