// Paths are stored as quads of four numbers each. The first quads of all paths follow each other, then their second
// ones, and so on, so that neighboring threads access whole lines of memory, four numbers at a time.
#ifndef PASSES_REFERENCE_QUADS_GLSL
#define PASSES_REFERENCE_QUADS_GLSL

#include "passes/reference/bindings.glsl"

const uint RADIANCE_QUAD = 8u;  // the light that the path has found, and how many rays it took

uint quad_index(uint path, uint quad) { return quad * (stored_paths.at.length() / STORED_QUADS) + path; }

void store_quad(uint path, uint quad, vec3 values, uint last) {
    stored_paths.at[quad_index(path, quad)] = uvec4(floatBitsToUint(values), last);
}

void store_quad(uint path, uint quad, vec3 values, float last) {
    store_quad(path, quad, values, floatBitsToUint(last));
}

vec3 load_quad(uint path, uint quad, out uint last) {
    uvec4 values = stored_paths.at[quad_index(path, quad)];
    last = values.w;
    return uintBitsToFloat(values.xyz);
}

vec3 load_quad(uint path, uint quad, out float last) {
    uint bits;
    vec3 values = load_quad(path, quad, bits);
    last = uintBitsToFloat(bits);
    return values;
}

vec3 load_radiance(uint index, out uint rays) { return load_quad(index, RADIANCE_QUAD, rays); }

#endif
