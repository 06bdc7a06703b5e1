// Runs the ray query of a probe and records its results: the first candidate, the committed hit, and the number of
// candidates.
#ifndef CONFORMANCE_PROBE_GLSL
#define CONFORMANCE_PROBE_GLSL

#include "generated/conformance/probe_actions.glsl"
#include "scene/ray_query.glsl"

struct Probe {
    vec3 origin;
    float t_min;
    vec3 direction;
    float t_max;
    uint flags;
    uint cull_mask;
    uint action;
    float parameter;
};

struct Found {  // RayIntersection, and Vulkan's object-space ray
    uint kind;
    float t;
    uint custom_data;
    uint instance;
    uint sbt_offset;
    uint geometry;
    uint primitive;
    vec2 barycentrics;
    uint front_face;
    mat4x3 object_to_world;
    mat4x3 world_to_object;
    vec3 object_origin;
    vec3 object_direction;
};

struct Answer {
    uint steps;                 // how often rayQueryProceed returned true
    uint box_candidates;
    uint opaque_boxes;          // AABB candidates that were opaque
    uint proceeds_after_end;
    float t_min;                // the ray as the getters return it
    uint flags;
    vec3 world_origin;
    vec3 world_direction;
    Found candidate;            // the first one
    Found committed;
};

layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 0, binding = 1, scalar) readonly buffer Probes { Probe at[]; } probes;
layout(set = 0, binding = 2, scalar) buffer Answers { Answer at[]; } answers;

Found found_of(RayIntersection hit, vec3 object_origin, vec3 object_direction) {
    return Found(hit.kind, hit.t, hit.instance_custom_data, hit.instance_index, hit.sbt_record_offset,
                 hit.geometry_index, hit.primitive_index, hit.barycentrics, hit.front_face ? 1u : 0u,
                 hit.object_to_world, hit.world_to_object, object_origin, object_direction);
}

// The smallest t > t_min at which an object-space ray meets the ball of radius 0.5 around a point; negative for a miss.
float sphere_t(vec3 origin, vec3 direction, vec3 center, float t_min) {
    vec3 from_center = origin - center;
    float a = dot(direction, direction), b = dot(from_center, direction);
    float discriminant = b * b - a * (dot(from_center, from_center) - 0.25);
    if (discriminant < 0.0) return -1.0;
    float root = sqrt(discriminant), near = (-b - root) / a;
    return near > t_min ? near : (-b + root) / a;
}

void run_probe(uint index) {
    Probe probe = probes.at[index];
    Found none = Found(RAY_QUERY_INTERSECTION_NONE, -1.0, 0u, 0u, 0u, 0u, 0u, vec2(-1.0), 0u, mat4x3(0.0), mat4x3(0.0),
                       vec3(0.0), vec3(0.0));
    Answer answer = Answer(0u, 0u, 0u, 0u, -1.0, 0u, vec3(0.0), vec3(0.0), none, none);
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, RayDesc(probe.flags, probe.cull_mask, probe.t_min, probe.t_max, probe.origin,
                                            probe.direction));
    while (answer.steps < STEP_LIMIT && rayQueryProceed(query)) {
        RayIntersection candidate = rayQueryGetCandidateIntersection(query);
        vec3 object_origin = rayQueryGetIntersectionObjectRayOriginEXT(query, false);
        vec3 object_direction = rayQueryGetIntersectionObjectRayDirectionEXT(query, false);
        if (answer.steps == 0u) answer.candidate = found_of(candidate, object_origin, object_direction);
        answer.steps++;
        if (candidate.kind == RAY_QUERY_INTERSECTION_AABB) {
            answer.box_candidates++;
            if (rayQueryGetIntersectionCandidateAABBOpaqueEXT(query)) answer.opaque_boxes++;
            if ((probe.action & GENERATE_AT) != 0u) {
                float nearer = (probe.action & NEARER) != 0u ? float(answer.box_candidates - 1u) : 0.0;
                rayQueryGenerateIntersection(query, probe.parameter - nearer);
            }
            if ((probe.action & GENERATE_SPHERE) != 0u) {
                // Box i spans [2 i, 2 i + 1] in x, [0, 1] in y and z, of object space.
                vec3 center = vec3(2.0 * float(candidate.primitive_index) + 0.5, 0.5, 0.5);
                float t = sphere_t(object_origin, object_direction, center, probe.t_min);
                if (t > probe.t_min && t < probe.t_max) rayQueryGenerateIntersection(query, t);
            }
        } else {
            bool odd = (probe.action & CONFIRM_ODD) != 0u && (candidate.primitive_index & 1u) == 1u;
            if ((probe.action & CONFIRM) != 0u || odd) rayQueryConfirmIntersection(query);
        }
        if ((probe.action & TERMINATE) != 0u) rayQueryTerminate(query);
    }
    answer.proceeds_after_end = rayQueryProceed(query) ? 1u : 0u;
    answer.t_min = rayQueryGetRayTMinEXT(query);
    answer.flags = rayQueryGetRayFlagsEXT(query);
    answer.world_origin = rayQueryGetWorldRayOriginEXT(query);
    answer.world_direction = rayQueryGetWorldRayDirectionEXT(query);
    RayIntersection committed = rayQueryGetCommittedIntersection(query);
    if (committed.kind != RAY_QUERY_INTERSECTION_NONE)
        answer.committed = found_of(committed, rayQueryGetIntersectionObjectRayOriginEXT(query, true),
                                    rayQueryGetIntersectionObjectRayDirectionEXT(query, true));
    answers.at[index] = answer;
}

#endif
