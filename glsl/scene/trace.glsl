// Tracing rays through the scene, the only file by which the renderer does it: by ray queries; in shaders that are
// compiled as ray generation shaders (RAY_PIPELINES) by a ray pipeline with scene/trace.rchit, scene/trace.rmiss and,
// in scenes with alpha, scene/trace.rahit; or by scene/trace_compute.glsl (RAYS_BY_COMPUTE). Passes that trace
// therefore use no shared memory and no barriers, and read their invocation's index from INVOCATION_INDEX. They keep
// few values across a ray, since on a GPU each one costs time.
#ifndef SCENE_TRACE_GLSL
#define SCENE_TRACE_GLSL

#ifdef RAY_PIPELINES
#extension GL_EXT_ray_tracing : require
#define INVOCATION_INDEX (gl_LaunchIDEXT.xy)
#define INVOCATION_LAYER gl_LaunchIDEXT.z
#else
#ifndef RAYS_BY_COMPUTE
#extension GL_EXT_ray_query : require
#endif
#define INVOCATION_INDEX (gl_GlobalInvocationID.xy)
#define INVOCATION_LAYER gl_GlobalInvocationID.z
#endif

#include "common/math.glsl"
#include "common/random.glsl"
#include "scene/alpha.glsl"
#include "scene/bindings.glsl"
#include "scene/camera_block.glsl"
#include "scene/hit.glsl"

// previous_tlas: the previous frame's, or `tlas`. With MANY_VIEWS they are the addresses of those of the world, and
// with RAYS_BY_COMPUTE of trees.
#if defined(MANY_VIEWS) || defined(RAYS_BY_COMPUTE)
struct WorldStructures {
    uvec2 now;
    uvec2 previous;
};
layout(set = 0, scalar) readonly buffer WorldStructuresBlock { WorldStructures at[]; } world_structures;
#ifdef MANY_VIEWS
#define STRUCTURES_INDEX world_index
#else
#define STRUCTURES_INDEX 0
#endif
#define tlas world_structures.at[STRUCTURES_INDEX].now
#define previous_tlas world_structures.at[STRUCTURES_INDEX].previous
#define Structure uvec2
#define structure_of accelerationStructureEXT
#else
layout(set = 0) uniform accelerationStructureEXT tlas;
layout(set = 0) uniform accelerationStructureEXT previous_tlas;
#define Structure accelerationStructureEXT
#define structure_of
#endif

#ifdef RAYS_BY_COMPUTE

const uint TRACE_BOTH_FACES = 0u;
// Returns the first hit that is found, which need not be the closest.
const uint TRACE_ANY_HIT = 1u;
// Camera rays pass through the backs of single-sided materials, as raster does.
const uint TRACE_FRONT_FACES = 2u;

#include "scene/trace_compute.glsl"

#else

// In scenes with alpha, instances say whether rays ask the shader about their triangles.
const uint TRACE_BOTH_FACES = SCENE_ALPHA ? gl_RayFlagsNoneEXT : gl_RayFlagsOpaqueEXT;
// Returns the first hit that is found, which need not be the closest.
const uint TRACE_ANY_HIT = TRACE_BOTH_FACES | gl_RayFlagsTerminateOnFirstHitEXT;
// Camera rays pass through the backs of single-sided materials, as raster does.
const uint TRACE_FRONT_FACES = TRACE_BOTH_FACES | gl_RayFlagsCullBackFacingTrianglesEXT;

#ifdef RAY_PIPELINES

#include "scene/payload.glsl"

layout(location = 0) rayPayloadEXT RayPayload ray_payload;

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags, uvec2 alpha_seed) {
    if (SCENE_BLEND) {
        ray_payload.instance = alpha_seed.x;
        ray_payload.triangle = alpha_seed.y;
    }
    traceRayEXT(structure_of(tlas), flags, SCENE_MASK, 0u, 0u, 0u, origin, t_min, direction, t_max, 0);
    if (ray_payload.instance == NO_INDEX) { return NO_HIT; }
    return Hit(
        ray_payload.t, ray_payload.instance >> 1u, ray_payload.triangle, ray_payload.barycentrics,
        (ray_payload.instance & 1u) != 0u
    );
}

// Returns whether nothing opaque is hit. Both faces of every triangle cast shadows.
bool trace_transmittance_in(
    Structure structure, vec3 origin, float t_min, vec3 direction, float t_max, uint mask,
    out RayTransmittance through
) {
    ray_payload.instance = 0u;  // edges that are passed, never NO_INDEX, which a miss sets
    if (SCENE_BLEND) { write_ray_transmittance(ray_payload, FULL_TRANSMITTANCE); }
    const uint flags = TRACE_ANY_HIT | gl_RayFlagsSkipClosestHitShaderEXT;
    traceRayEXT(structure_of(structure), flags, mask, 0u, 0u, 0u, origin, t_min, direction, t_max, 0);
    through = SCENE_BLEND ? read_ray_transmittance(ray_payload) : FULL_TRANSMITTANCE;
    return ray_payload.instance == NO_INDEX;
}

#else

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags, uvec2 alpha_seed) {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, structure_of(tlas), flags, SCENE_MASK, origin, t_min, direction, t_max);
    while (rayQueryProceedEXT(query)) {
        if (!SCENE_ALPHA) { continue; }
        uint instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false));
        uint triangle = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, false));
        bool is_camera_ray = (flags & gl_RayFlagsCullBackFacingTrianglesEXT) != 0u;
        vec2 barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, false);
        vec4 filter_opacity = resolve_filter_opacity(instance, triangle, barycentrics, direction, is_camera_ray);
        if (accepts_hit(filter_opacity.w, alpha_seed, instance, triangle, barycentrics)) {
            rayQueryConfirmIntersectionEXT(query);
        }
    }
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

// Returns whether nothing opaque is hit. Both faces of every triangle cast shadows.
bool trace_transmittance_in(
    Structure structure, vec3 origin, float t_min, vec3 direction, float t_max, uint mask,
    out RayTransmittance through
) {
    through = FULL_TRANSMITTANCE;
    uint passed_edges = 0u;
    rayQueryEXT query;
    rayQueryInitializeEXT(query, structure_of(structure), TRACE_ANY_HIT, mask, origin, t_min, direction, t_max);
    while (rayQueryProceedEXT(query)) {
        if (!SCENE_ALPHA) { continue; }
        uint instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false));
        uint triangle = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, false));
        vec2 barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, false);
        vec4 filter_opacity = resolve_filter_opacity(instance, triangle, barycentrics, direction, false);
        if (filter_opacity.w >= 1.0) {
            rayQueryConfirmIntersectionEXT(query);
        } else if (SCENE_BLEND) {
            attenuate_by_surface(through, passed_edges, filter_opacity, instance, triangle, barycentrics);
        }
    }
    return rayQueryGetIntersectionTypeEXT(query, true) == gl_RayQueryCommittedIntersectionNoneEXT;
}

#endif
#endif

// ---- surfaces ---------------------------------------------------------------------------------------

// Decides which blended surfaces a ray passes (see alpha_threshold), independently of other rays.
uvec2 random_alpha_seed(inout uint rng) {
    return SCENE_BLEND && uses_random_numbers_for(WITHOUT_BLEND) ? uvec2(0u, rand_u(rng)) : uvec2(0u);
}

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags) {
    return trace_closest_hit(origin, t_min, direction, t_max, flags, uvec2(0u));
}

// The transmittance of a ray from its origin to its hit: of the blended surfaces that it has passed.
RayTransmittance trace_transmittance_and_probability(vec3 origin, vec3 direction, float t_max, Hit hit) {
    RayTransmittance through = FULL_TRANSMITTANCE;
    if (SCENE_BLEND) {
        // ends before the hit, which may be on a blended surface too
        float end = hit.instance == NO_INDEX ? t_max : uintBitsToFloat(max(floatBitsToUint(hit.t), 1u) - 1u);
        trace_transmittance_in(tlas, origin, 0.0, direction, end, BLENDED_MASK, through);
    }
    return through;
}

// ---- light ------------------------------------------------------------------------------------------

vec3 trace_transmittance_in(Structure structure, vec3 origin, vec3 direction, float t_max) {
    RayTransmittance through;
    bool passes = trace_transmittance_in(structure, origin, 0.0, direction, t_max, SCENE_MASK, through);
    return passes ? through.weight * through.probability : vec3(0.0);
}

// The share of light that passes: 0 behind an opaque surface. Its mean is known without random numbers.
vec3 trace_transmittance(vec3 origin, vec3 direction, float t_max) {
    return trace_transmittance_in(tlas, origin, direction, t_max);
}

// The same in the scene as it was in the previous frame.
vec3 trace_previous_transmittance(vec3 origin, vec3 direction, float t_max) {
    return trace_transmittance_in(previous_tlas, origin, direction, t_max);
}

// Returns whether any light passes.
bool trace_visibility(vec3 origin, vec3 direction, float t_max) {
    return trace_transmittance(origin, direction, t_max) != vec3(0.0);
}

#endif
