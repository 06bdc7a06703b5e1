// What buffers keep of a path from one pass to the next: quads of four numbers, which passes/paths/pack_path.glsl
// packs. A buffer has the first quads of all paths, then their second ones, and so on, so that neighboring threads
// access whole lines of memory, four numbers at a time.
#ifndef PASSES_PATHS_STORED_PATH_GLSL
#define PASSES_PATHS_STORED_PATH_GLSL

#include "generated/passes/paths.glsl"  // STATE_QUADS, RAYS_QUADS, HIT_QUADS: solari_vk/passes/paths.py
#include "passes/paths/per_lobe.glsl"

// A path that waits at a vertex, without what can be computed again.
struct PathState { uvec4 quads[STATE_QUADS]; };

// The rays that a path has chosen, for a pass that only traces.
struct PathRays { uvec4 quads[RAYS_QUADS]; };

// What that pass has found along them.
struct PathHit { uvec4 quads[HIT_QUADS]; };

// A ray to a light sample, and what the vertex from which it leaves reflects of that if nothing is in between.
struct ShadowRay {
    vec3 origin;
    vec3 direction;
    float t_max;
    PerLobe contribution;  // 0: there is no ray
};

uvec4 quad(vec3 values, uint last) { return uvec4(floatBitsToUint(values), last); }
uvec4 quad(vec3 values, float last) { return quad(values, floatBitsToUint(last)); }
vec3 values_of(uvec4 quad) { return uintBitsToFloat(quad.xyz); }
float last_of(uvec4 quad) { return uintBitsToFloat(quad.w); }

#endif
