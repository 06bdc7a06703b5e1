// Rays and their closest hits, for ray queries (trace.comp) and for ray pipelines (trace.rgen).
#ifndef CONFORMANCE_TRACE_RAYS_GLSL
#define CONFORMANCE_TRACE_RAYS_GLSL

#extension GL_EXT_scalar_block_layout : require

struct Ray {
    vec3 origin;
    float t_min;
    vec3 direction;
    float t_max;
    uint flags;
    uint cull_mask;
    float box_t;  // where candidate boxes are hit; 0 passes them over
};

struct Hit {
    float t;  // negative when nothing was hit
    uint custom_data;
    uint instance;
    uint geometry;
    uint primitive;
};

layout(set = 0, scalar) readonly buffer Rays { Ray at[]; } rays;
layout(set = 0, scalar) writeonly buffer Hits { Hit at[]; } hits;

#endif
