// All rays of all passes. Another way of tracing (ray tracing pipelines) replaces this file and nothing else, so passes
// that trace use no shared memory and no barriers, and take their place in the dispatch from INVOCATION_INDEX.
#ifndef SCENE_TRACE_GLSL
#define SCENE_TRACE_GLSL

#extension GL_EXT_ray_query : require

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/hit.glsl"

layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;

#define INVOCATION_INDEX (gl_GlobalInvocationID.xy)

const uint TRACE_BOTH_FACES = gl_RayFlagsOpaqueEXT;
const uint TRACE_ANY_HIT = gl_RayFlagsOpaqueEXT | gl_RayFlagsTerminateOnFirstHitEXT;  // the first that is found
// Camera rays look through the backs of single-sided materials, as raster does.
const uint TRACE_FRONT_FACES = gl_RayFlagsOpaqueEXT | gl_RayFlagsCullBackFacingTrianglesEXT;

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags) {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, tlas, flags, 0xFFu, origin, t_min, direction, t_max);
    while (rayQueryProceedEXT(query)) {}
    if (rayQueryGetIntersectionTypeEXT(query, true) != gl_RayQueryCommittedIntersectionTriangleEXT) {
        return Hit(INFINITY, NO_INDEX, 0u, vec2(0.0), false);
    }
    return Hit(
        rayQueryGetIntersectionTEXT(query, true),
        uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, true)),
        uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, true)),
        rayQueryGetIntersectionBarycentricsEXT(query, true),
        rayQueryGetIntersectionFrontFaceEXT(query, true)
    );
}

// Whether nothing stands on the way; both faces of everything cast shadows.
bool trace_visibility(vec3 origin, vec3 direction, float t_max) {
    rayQueryEXT query;
    const uint flags = gl_RayFlagsOpaqueEXT | gl_RayFlagsTerminateOnFirstHitEXT;
    rayQueryInitializeEXT(query, tlas, flags, 0xFFu, origin, 0.0, direction, t_max);
    while (rayQueryProceedEXT(query)) {}
    return rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionNoneEXT;
}

#endif
