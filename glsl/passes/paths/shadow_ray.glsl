#ifndef PASSES_PATHS_SHADOW_RAY_GLSL
#define PASSES_PATHS_SHADOW_RAY_GLSL

#include "passes/paths/per_lobe.glsl"

// A ray to a light sample, and what the vertex from which it leaves reflects of that if nothing is in between.
struct ShadowRay {
    vec3 origin;
    vec3 direction;
    float t_max;
    PerLobe contribution;  // 0: there is no ray
};

#endif
