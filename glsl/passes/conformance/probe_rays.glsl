// What the shaders of a ray pipeline record about a probe. Each probe is one invocation of probe.rgen.
#ifndef CONFORMANCE_PROBE_RAYS_GLSL
#define CONFORMANCE_PROBE_RAYS_GLSL

#extension GL_EXT_ray_tracing : require

#include "passes/conformance/probe_found.glsl"

struct RayAnswer {
    uint ended;           // the payload: ENDED_*
    uint steps;           // any-hit shaders of triangles and intersection shaders that ran
    uint box_candidates;  // intersection shaders
    uint accepted;        // reportIntersectionEXT that returned true
    uint box_any_hits;    // any-hit shaders of AABBs
    uint closest_hits;    // closest-hit shaders
    uint misses;          // miss shaders
    uint hit_kind;
    float t_min;          // the ray as closest-hit and miss shaders see it
    uint flags;
    vec3 world_origin;
    vec3 world_direction;
    Found candidate;      // the first one
    Found committed;
};

layout(set = 0, scalar) buffer RayAnswers { RayAnswer at[]; } ray_answers;

const uint ENDED_NOWHERE = 1u;  // the ray generation shader's; no shader has run after it
const uint ENDED_AT_HIT = 2u;
const uint ENDED_AT_MISS = 3u;
const uint REPORTED_KIND = 77u;

#define RAY_ANSWER ray_answers.at[gl_LaunchIDEXT.x]

// What hit shaders see of the geometry.
#define FOUND(KIND, T, BARYCENTRICS, FRONT_FACE) Found( \
    KIND, T, uint(gl_InstanceCustomIndexEXT), uint(gl_InstanceID), 0u, uint(gl_GeometryIndexEXT), \
    uint(gl_PrimitiveID), BARYCENTRICS, FRONT_FACE, gl_ObjectToWorldEXT, gl_WorldToObjectEXT, \
    gl_ObjectRayOriginEXT, gl_ObjectRayDirectionEXT)

#define RECORD_RAY { \
    RAY_ANSWER.t_min = gl_RayTminEXT; \
    RAY_ANSWER.flags = gl_IncomingRayFlagsEXT; \
    RAY_ANSWER.world_origin = gl_WorldRayOriginEXT; \
    RAY_ANSWER.world_direction = gl_WorldRayDirectionEXT; \
}

#endif
