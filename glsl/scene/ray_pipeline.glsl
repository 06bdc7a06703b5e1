// The ray of the wgpu ray tracing document by a ray pipeline, in shaders of a RayPass. `payload` is the location of a
// rayPayloadEXT, a constant. A ray that the document calls invalid is discarded: the payload stays as it was.
#ifndef SCENE_RAY_PIPELINE_GLSL
#define SCENE_RAY_PIPELINE_GLSL

#extension GL_EXT_ray_tracing : require

#include "scene/ray_desc.glsl"

// A macro, because GLSL takes the payload's location as a literal.
#define traceRay(structure, desc, payload) do { \
    RayDesc traced = desc; \
    if (ray_query_is_valid(traced) && ray_query_flags_agree(traced.flags)) { \
        traceRayEXT( \
            structure, traced.flags, traced.cull_mask & 0xFFu, 0u, 0u, 0u, traced.origin, traced.t_min, traced.dir, \
            traced.t_max, payload \
        ); \
    } \
} while (false)

#endif
