// Runs the ray query of a probe and records its results: the first candidate, the committed hit, and the number of
// candidates.
#ifndef CONFORMANCE_PROBE_GLSL
#define CONFORMANCE_PROBE_GLSL

#include "passes/conformance/probe_found.glsl"
#include "scene/ray_query.glsl"

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

layout(set = 0) uniform accelerationStructureEXT tlas;
layout(set = 0, scalar) buffer Answers { Answer at[]; } answers;

Found found_of(RayIntersection hit, vec3 object_origin, vec3 object_direction) {
    return Found(hit.kind, hit.t, hit.instance_custom_data, hit.instance_index, hit.sbt_record_offset,
                 hit.geometry_index, hit.primitive_index, hit.barycentrics, hit.front_face ? 1u : 0u,
                 hit.object_to_world, hit.world_to_object, object_origin, object_direction);
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
                rayQueryGenerateIntersection(query, generated_t(probe, answer.box_candidates - 1u));
            }
            if ((probe.action & GENERATE_SPHERE) != 0u) {
                vec3 center = ball_center(candidate.primitive_index);
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
