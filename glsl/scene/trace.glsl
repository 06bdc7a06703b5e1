// Tracing rays through the scene, the only file by which the renderer does it: by ray queries, or, in shaders that are
// compiled as ray generation shaders (RAY_PIPELINES), by a ray pipeline with scene/trace.rchit and scene/trace.rmiss.
// Passes that trace therefore use no shared memory and no barriers, and read their invocation's index from
// INVOCATION_INDEX. They keep few values across a ray, since on a GPU each one costs time.
#ifndef SCENE_TRACE_GLSL
#define SCENE_TRACE_GLSL

#ifdef RAY_PIPELINES
#extension GL_EXT_ray_tracing : require
#define INVOCATION_INDEX (gl_LaunchIDEXT.xy)
#else
#extension GL_EXT_ray_query : require
#define INVOCATION_INDEX (gl_GlobalInvocationID.xy)
#endif

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/hit.glsl"

layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 0, binding = 12) uniform accelerationStructureEXT previous_tlas;  // the previous frame's, or `tlas`

const uint TRACE_BOTH_FACES = gl_RayFlagsOpaqueEXT;
// Returns the first hit that is found, which need not be the closest.
const uint TRACE_ANY_HIT = gl_RayFlagsOpaqueEXT | gl_RayFlagsTerminateOnFirstHitEXT;
// Camera rays pass through the backs of single-sided materials, as raster does.
const uint TRACE_FRONT_FACES = gl_RayFlagsOpaqueEXT | gl_RayFlagsCullBackFacingTrianglesEXT;

#ifdef RAY_PIPELINES

#include "scene/payload.glsl"

layout(location = 0) rayPayloadEXT RayPayload ray_payload;

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags) {
    traceRayEXT(tlas, flags, SCENE_MASK, 0u, 0u, 0u, origin, t_min, direction, t_max, 0);
    if (ray_payload.instance == NO_INDEX) { return NO_HIT; }
    return Hit(
        ray_payload.t, ray_payload.instance >> 1u, ray_payload.triangle, ray_payload.barycentrics,
        (ray_payload.instance & 1u) != 0u
    );
}

// Returns whether nothing is hit. Both faces of every triangle cast shadows.
bool trace_visibility_in(accelerationStructureEXT structure, vec3 origin, vec3 direction, float t_max) {
    ray_payload.instance = 0u;  // a hit runs no shader, a miss sets NO_INDEX
    uint flags = TRACE_ANY_HIT | gl_RayFlagsSkipClosestHitShaderEXT;
    traceRayEXT(structure, flags, SCENE_MASK, 0u, 0u, 0u, origin, 0.0, direction, t_max, 0);
    return ray_payload.instance == NO_INDEX;
}

#else

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags) {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, tlas, flags, SCENE_MASK, origin, t_min, direction, t_max);
    while (rayQueryProceedEXT(query)) {}
    if (rayQueryGetIntersectionTypeEXT(query, true) != gl_RayQueryCommittedIntersectionTriangleEXT) {
        return NO_HIT;
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
bool trace_visibility_in(accelerationStructureEXT structure, vec3 origin, vec3 direction, float t_max) {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, structure, TRACE_ANY_HIT, SCENE_MASK, origin, 0.0, direction, t_max);
    while (rayQueryProceedEXT(query)) {}
    return rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionNoneEXT;
}

#endif

bool trace_visibility(vec3 origin, vec3 direction, float t_max) {
    return trace_visibility_in(tlas, origin, direction, t_max);
}

// The same in the scene as it was in the previous frame.
bool trace_previous_visibility(vec3 origin, vec3 direction, float t_max) {
    return trace_visibility_in(previous_tlas, origin, direction, t_max);
}

#endif
