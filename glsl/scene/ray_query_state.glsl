// The document's functions: a record beside each query tracks its state, by which calls are discarded, and in the debug
// build counted by the rule that they broke.
#ifndef SCENE_RAY_QUERY_STATE_GLSL
#define SCENE_RAY_QUERY_STATE_GLSL

#include "generated/gpu/frame/ray_query_faults.glsl"

const uint RAY_QUERY_UNKNOWN = 0u;
const uint RAY_QUERY_INITIALIZED = 1u;
const uint RAY_QUERY_AT_CANDIDATE = 2u;
const uint RAY_QUERY_DONE = 3u;

struct RayQueryRecord {
    uint phase;
    float t_min;
    float t_max;
};

#ifdef RAY_QUERY_DEBUG
#ifndef RAY_QUERY_INVOCATION
#define RAY_QUERY_INVOCATION gl_GlobalInvocationID
#endif

struct RayQueryFault {
    uint count;
    uvec3 invocation;  // the first invocation that broke the rule
};
layout(set = 1, scalar) buffer RayQueryFaultsBlock {
    RayQueryFault at[];
} ray_query_faults;

// Returns whether a rule is kept, and counts the fault otherwise.
bool ray_query_rule(bool kept, uint fault) {
    if (!kept && atomicAdd(ray_query_faults.at[fault].count, 1u) == 0u) {
        ray_query_faults.at[fault].invocation = RAY_QUERY_INVOCATION;
    }
    return kept;
}
#else
#define ray_query_rule(kept, fault) (kept)
#endif

// A ray that breaks a rule is replaced by one that meets nothing.
void ray_query_initialize(
    rayQueryEXT query, inout RayQueryRecord record, accelerationStructureEXT structure, RayDesc desc
) {
    bool valid = ray_query_rule(ray_query_is_valid(desc), FAULT_INVALID_RAY);
    valid = ray_query_rule(ray_query_flags_agree(desc.flags), FAULT_CONTRADICTING_FLAGS) && valid;
    if (!valid) { desc = RAY_QUERY_NO_RAY; }
    record = RayQueryRecord(RAY_QUERY_INITIALIZED, desc.t_min, desc.t_max);
    rayQueryInitializeEXT(
        query, structure, desc.flags, desc.cull_mask & 0xFFu, desc.origin, desc.t_min, desc.dir, desc.t_max
    );
}

bool ray_query_proceed(rayQueryEXT query, inout RayQueryRecord record) {
    if (!ray_query_rule(record.phase != RAY_QUERY_UNKNOWN, FAULT_PROCEED_BEFORE_INITIALIZE)) { return false; }
    if (record.phase == RAY_QUERY_DONE) { return false; }
    bool candidate = rayQueryProceedEXT(query);
    record.phase = candidate ? RAY_QUERY_AT_CANDIDATE : RAY_QUERY_DONE;
    return candidate;
}

void ray_query_generate_checked(rayQueryEXT query, RayQueryRecord record, float hit_t) {
    if (!ray_query_rule(record.phase == RAY_QUERY_AT_CANDIDATE, FAULT_GENERATE_WITHOUT_CANDIDATE)) { return; }
    bool box = ray_query_candidate_kind(query) == RAY_QUERY_INTERSECTION_AABB;
    bool inside = hit_t >= record.t_min && hit_t <= record.t_max;
    if (ray_query_rule(box, FAULT_GENERATE_OF_NO_AABB) && ray_query_rule(inside, FAULT_GENERATE_OUT_OF_RANGE)) {
        ray_query_generate(query, hit_t);
    }
}

void ray_query_confirm_checked(rayQueryEXT query, RayQueryRecord record) {
    if (!ray_query_rule(record.phase == RAY_QUERY_AT_CANDIDATE, FAULT_CONFIRM_WITHOUT_CANDIDATE)) { return; }
    bool triangle = ray_query_candidate_kind(query) == RAY_QUERY_INTERSECTION_TRIANGLE;
    if (ray_query_rule(triangle, FAULT_CONFIRM_OF_NO_TRIANGLE)) { rayQueryConfirmIntersectionEXT(query); }
}

void ray_query_terminate_checked(rayQueryEXT query, RayQueryRecord record) {
    if (!ray_query_rule(record.phase != RAY_QUERY_UNKNOWN, FAULT_TERMINATE_BEFORE_INITIALIZE)) { return; }
    if (record.phase != RAY_QUERY_DONE) { rayQueryTerminateEXT(query); }
}

// Returns whether the query is in the phase that a getter requires.
bool ray_query_stands(RayQueryRecord record, uint phase, uint fault) {
    if (!ray_query_rule(record.phase >= RAY_QUERY_AT_CANDIDATE, FAULT_GET_BEFORE_PROCEED)) { return false; }
    return ray_query_rule(record.phase == phase, fault);
}

RayIntersection ray_query_committed_checked(rayQueryEXT query, RayQueryRecord record) {
    bool stands = ray_query_stands(record, RAY_QUERY_DONE, FAULT_COMMITTED_WHILE_CANDIDATE);
    if (!stands) { return ray_query_no_intersection(); }
    return ray_query_committed(query);
}

RayIntersection ray_query_candidate_checked(rayQueryEXT query, RayQueryRecord record) {
    bool stands = ray_query_stands(record, RAY_QUERY_AT_CANDIDATE, FAULT_CANDIDATE_WHILE_COMMITTED);
    if (!stands) { return ray_query_no_intersection(); }
    return ray_query_candidate(query);
}

#ifdef RAY_QUERY_VERTEX_RETURN
vec3[3] ray_query_committed_positions(rayQueryEXT query, RayQueryRecord record) {
    bool stands = ray_query_stands(record, RAY_QUERY_DONE, FAULT_COMMITTED_POSITIONS_WHILE_CANDIDATE);
    bool triangle = stands && ray_query_committed_kind(query) == RAY_QUERY_INTERSECTION_TRIANGLE;
    if (!stands || !ray_query_rule(triangle, FAULT_POSITIONS_OF_NO_TRIANGLE)) {
        return vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    }
    return ray_query_positions(query, 1);
}

vec3[3] ray_query_candidate_positions(rayQueryEXT query, RayQueryRecord record) {
    bool stands = ray_query_stands(record, RAY_QUERY_AT_CANDIDATE, FAULT_CANDIDATE_POSITIONS_WHILE_COMMITTED);
    bool triangle = stands && ray_query_candidate_kind(query) == RAY_QUERY_INTERSECTION_TRIANGLE;
    if (!stands || !ray_query_rule(triangle, FAULT_POSITIONS_OF_NO_TRIANGLE)) {
        return vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    }
    return ray_query_positions(query, 0);
}
#endif

#define RAY_QUERY(query) rayQueryEXT query; RayQueryRecord query##_record = RayQueryRecord(RAY_QUERY_UNKNOWN, 0.0, 0.0)
#define RAY_QUERY_PARAMETER(query) rayQueryEXT query, inout RayQueryRecord query##_record
#define RAY_QUERY_ARGUMENT(query) query, query##_record
#define rayQueryInitialize(query, structure, desc) ray_query_initialize(query, query##_record, structure, desc)
#define rayQueryProceed(query) ray_query_proceed(query, query##_record)
#define rayQueryGenerateIntersection(query, hit_t) ray_query_generate_checked(query, query##_record, hit_t)
#define rayQueryConfirmIntersection(query) ray_query_confirm_checked(query, query##_record)
#define rayQueryTerminate(query) ray_query_terminate_checked(query, query##_record)
#define rayQueryGetCommittedIntersection(query) ray_query_committed_checked(query, query##_record)
#define rayQueryGetCandidateIntersection(query) ray_query_candidate_checked(query, query##_record)
#define getCommittedHitVertexPositions(query) ray_query_committed_positions(query, query##_record)
#define getCandidateHitVertexPositions(query) ray_query_candidate_positions(query, query##_record)

#endif
