// What buffers keep of a path from one pass to the next.
#ifndef PASSES_PATHS_STORED_PATH_GLSL
#define PASSES_PATHS_STORED_PATH_GLSL

#include "passes/paths/per_lobe.glsl"
#include "scene/medium.glsl"

// A ray to a light sample, and what the vertex from which it leaves reflects of that if nothing is in between.
struct ShadowRay {
    vec3 origin;
    vec3 direction;
    float t_max;
    PerLobe contribution;  // 0: there is no ray
};

// A path that waits at a vertex, as passes/paths/pack_path.glsl packs it. What can be computed again is left out.
struct PathState {
    uint rng;
    uint flags;  // bounce | delta_bounces << 8 | wavelength << 16 | IS_DIFFUSE | SPECULAR_ONLY
    PerLobe attenuated_first_weight;  // path.first_weight times the transmittance of the first ray
    vec3 throughput;
    vec3 direction;
    uint instance;
    uint triangle;
    vec2 barycentrics;
    float sum_of_inverse_pdfs;
    float footprint;
    float cone_width;
    Medium medium;
};

// The rays that a path has chosen, for a pass that only traces.
struct PathRays {
    uint has_ray;  // 0: only the shadow ray is traced, and the path ends
    vec3 origin;   // of the ray that leads on, in PathState.direction
    float mis_pdf;
    float wavelength;
    vec3 receiver_position;
    vec3 receiver_normal;
    ShadowRay shadow_ray;
    uvec3 light_sample;
};

// What that pass has found along them.
struct PathHit {
    vec3 visibility;  // of the light sample
    float t;
    uint instance;
    uint triangle;
    vec2 barycentrics;
    vec4 transmittance;  // RayTransmittance
    vec3 light_along_ray;
    vec3 light_along_ray_over_probability;
};

#endif
