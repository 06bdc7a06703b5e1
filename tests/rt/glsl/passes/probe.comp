#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/ray_query.glsl"
layout(local_size_x = 64) in;
struct Ray { RayDesc desc; uint action; float hit_t; float hit_step; };  // hits are generated ever farther
struct Answer { RayIntersection hit; uint candidates; RayIntersection candidate; vec3 positions[3]; };
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) readonly buffer RaysBlock { Ray at[]; } rays;
layout(set = 1, binding = 1, scalar) buffer AnswersBlock { Answer at[]; } answers;

const uint CONFIRM = 1u, GENERATE = 2u, TERMINATE = 4u;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= rays.at.length()) { return; }
    Ray ray = rays.at[i];
    Answer answer;
    answer.candidates = 0u;
    answer.candidate = ray_query_no_intersection();
    answer.positions = vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, ray.desc);
    while (rayQueryProceed(query)) {
        answer.candidate = rayQueryGetCandidateIntersection(query);
        answer.candidates += 1u;
        bool box = answer.candidate.kind == RAY_QUERY_INTERSECTION_AABB;
        if (box && (ray.action & GENERATE) != 0u) { rayQueryGenerateIntersection(query, ray.hit_t); }
        ray.hit_t += ray.hit_step;
        if (!box && (ray.action & CONFIRM) != 0u) { rayQueryConfirmIntersection(query); }
        if ((ray.action & TERMINATE) != 0u) { rayQueryTerminate(query); }
    }
    answer.hit = rayQueryGetCommittedIntersection(query);
#ifdef RAY_QUERY_VERTEX_RETURN
    if (answer.hit.kind == RAY_QUERY_INTERSECTION_TRIANGLE) { answer.positions = getCommittedHitVertexPositions(query); }
#endif
    answers.at[i] = answer;
}
