// Calls that the wgpu document discards, one in each invocation, and whether they left anything.
// solari_vk/lab/conformance/discarded_checks.py has the names of the cases.
#version 460
#include "scene/ray_query.glsl"

layout(local_size_x = 32) in;

layout(set = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, scalar) writeonly buffer LeftBlock { uint at[]; } left;

// Where rays start, by what is below: a triangle that is opaque, one that isn't, a box, nothing.
const float OPAQUE = 0.6, GLASS = 2.6, BOX = 6.6, NOTHING = 8.6;
RayDesc down(float x, uint flags) { return RayDesc(flags, 0xFFu, 1.0, 9.0, vec3(x, 0.3, 5.0), vec3(0.0, 0.0, -1.0)); }
#define START(x) rayQueryInitialize(query, tlas, down(x, RAY_FLAG_NONE))
#define PROCEED rayQueryProceed(query)
#define COMMITTED rayQueryGetCommittedIntersection(query)
#define CANDIDATE rayQueryGetCandidateIntersection(query)
#define FINISH while (PROCEED) {}
#define HIT_AT(wanted) (COMMITTED.kind != RAY_QUERY_INTERSECTION_NONE && abs(COMMITTED.t - (wanted)) < 1e-3)

// Whether any field isn't 0.
bool is_set(RayIntersection hit) {
    uint numbers = hit.kind | hit.instance_custom_data | hit.instance_index | hit.sbt_record_offset
        | hit.geometry_index | hit.primitive_index;
    return numbers != 0u || hit.t != 0.0 || hit.barycentrics != vec2(0.0) || hit.front_face
        || hit.object_to_world != mat4x3(0.0) || hit.world_to_object != mat4x3(0.0);
}

bool hits_with(uint flags) {
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, down(OPAQUE, flags));
    FINISH
    return is_set(COMMITTED);
}

bool is_wrong(uint number) {
    RAY_QUERY(query);
    switch (number) {
    case 0u: START(OPAQUE); FINISH return !HIT_AT(5.0);
    case 1u: return PROCEED;
    case 2u: return is_set(COMMITTED);
    case 3u: return is_set(CANDIDATE);
    case 4u: START(OPAQUE); return is_set(COMMITTED);
    case 5u: START(GLASS); return is_set(CANDIDATE);
    case 6u: START(GLASS); PROCEED; return is_set(COMMITTED);
    case 7u: START(OPAQUE); PROCEED; return is_set(CANDIDATE);
    case 8u: START(GLASS); FINISH return PROCEED || PROCEED;
    case 9u: rayQueryGenerateIntersection(query, 4.5); START(NOTHING); FINISH return is_set(COMMITTED);
    case 10u: START(BOX); FINISH rayQueryGenerateIntersection(query, 4.5); return is_set(COMMITTED);
    case 11u: START(BOX); PROCEED; rayQueryGenerateIntersection(query, 0.5); FINISH return is_set(COMMITTED);
    case 12u: START(BOX); PROCEED; rayQueryGenerateIntersection(query, 9.5); FINISH return is_set(COMMITTED);
    case 13u:
        START(BOX);
        PROCEED;
        rayQueryGenerateIntersection(query, 4.5);
        rayQueryGenerateIntersection(query, 8.0);
        FINISH
        return !HIT_AT(4.5);
    case 14u: rayQueryConfirmIntersection(query); START(GLASS); FINISH return is_set(COMMITTED);
    case 15u: START(GLASS); FINISH rayQueryConfirmIntersection(query); return is_set(COMMITTED);
    case 16u: rayQueryTerminate(query); START(OPAQUE); FINISH return !HIT_AT(5.0);
    case 17u: START(OPAQUE); FINISH rayQueryTerminate(query); return !HIT_AT(5.0);
    case 18u: START(GLASS); PROCEED; rayQueryTerminate(query); return is_set(COMMITTED) || PROCEED;
    case 19u: return hits_with(FORCE_OPAQUE | FORCE_NO_OPAQUE) || hits_with(FORCE_OPAQUE | CULL_NO_OPAQUE);
    case 20u:
        return hits_with(CULL_FRONT_FACING | CULL_BACK_FACING) || hits_with(CULL_BACK_FACING | SKIP_TRIANGLES);
    case 21u: return hits_with(SKIP_TRIANGLES | SKIP_AABBS);
    }
    return true;
}

void main() {
    uint number = gl_GlobalInvocationID.x;
    if (number < left.at.length()) { left.at[number] = uint(is_wrong(number)); }
}
