// Tracing rays through the scene: the only file of the renderer that uses ray queries. A backend with ray tracing
// pipelines replaces this file alone. Passes that trace therefore use no shared memory and no barriers, and read their
// invocation's index from INVOCATION_INDEX.
#ifndef SCENE_TRACE_GLSL
#define SCENE_TRACE_GLSL

#extension GL_EXT_ray_query : require

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/hit.glsl"

layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;

#define INVOCATION_INDEX (gl_GlobalInvocationID.xy)

const uint TRACE_BOTH_FACES = gl_RayFlagsOpaqueEXT;
// Returns the first hit that is found, which need not be the closest.
const uint TRACE_ANY_HIT = gl_RayFlagsOpaqueEXT | gl_RayFlagsTerminateOnFirstHitEXT;
// Camera rays pass through the backs of single-sided materials, as raster does.
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

// Returns whether nothing is hit. Both faces of every triangle cast shadows.
bool trace_visibility(vec3 origin, vec3 direction, float t_max) {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, tlas, TRACE_ANY_HIT, 0xFFu, origin, 0.0, direction, t_max);
    while (rayQueryProceedEXT(query)) {}
    return rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionNoneEXT;
}

#endif
