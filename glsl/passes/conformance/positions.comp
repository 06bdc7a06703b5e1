// The vertices of candidate and committed triangles, on devices that return them.
#version 460
#define RAY_QUERY_VERTEX_RETURN
#include "passes/conformance/probe.glsl"

layout(local_size_x = 32) in;

struct Vertices {
    uint kind;
    vec3 candidate[3];
    vec3 committed[3];
};

layout(set = 0, scalar) writeonly buffer Corners { Vertices at[]; } corners;

Vertices find_vertices(Probe probe) {
    const vec3[3] none = vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    Vertices vertices = Vertices(0u, none, none);
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, RayDesc(probe.flags, probe.cull_mask, probe.t_min, probe.t_max, probe.origin,
                                            probe.direction));
    while (rayQueryProceed(query)) {
        if (rayQueryGetCandidateIntersection(query).kind != RAY_QUERY_INTERSECTION_TRIANGLE) continue;
        vertices.candidate = getCandidateHitVertexPositions(query);
        rayQueryConfirmIntersection(query);
    }
    vertices.kind = rayQueryGetCommittedIntersection(query).kind;
    if (vertices.kind == RAY_QUERY_INTERSECTION_TRIANGLE) vertices.committed = getCommittedHitVertexPositions(query);
    return vertices;
}

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index < probes.at.length()) { corners.at[index] = find_vertices(probes.at[index]); }
}
