// What the shaders of a ray pipeline that trace rays themselves tell their caller.
#ifndef CONFORMANCE_NESTED_GLSL
#define CONFORMANCE_NESTED_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "scene/ray_pipeline.glsl"

struct Nested {
    uint depth;
    uint hits;  // of this ray, and ten times those of the ray that its hit or miss shader traced
    uint misses;
};
struct NestedRay {
    uint flags;
    float t_min;
    float t_max;
    vec3 origin;
    vec3 direction;
};
layout(set = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, scalar) readonly buffer NestedRaysBlock { NestedRay at[]; } nested_rays;
layout(set = 1, scalar) writeonly buffer NestedFoundBlock { Nested at[]; } nested_found;

#endif
