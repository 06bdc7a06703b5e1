// The closest hit of many rays; candidate triangles are confirmed, boxes hit where the ray says.
#version 460
#include "passes/conformance/trace_rays.glsl"
#include "scene/ray_query.glsl"

layout(local_size_x = 64) in;

layout(set = 0) uniform accelerationStructureEXT tlas;

Hit trace_ray(Ray ray) {
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, RayDesc(ray.flags, ray.cull_mask, ray.t_min, ray.t_max, ray.origin, ray.direction));
    while (rayQueryProceed(query)) {
        if (rayQueryGetCandidateIntersection(query).kind == RAY_QUERY_INTERSECTION_TRIANGLE) {
            rayQueryConfirmIntersection(query);
        } else if (ray.box_t > 0.0) {
            rayQueryGenerateIntersection(query, ray.box_t);
        }
    }
    RayIntersection hit = rayQueryGetCommittedIntersection(query);
    float t = hit.kind == RAY_QUERY_INTERSECTION_NONE ? -1.0 : hit.t;
    return Hit(t, hit.instance_custom_data, hit.instance_index, hit.geometry_index, hit.primitive_index);
}

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index < rays.at.length()) { hits.at[index] = trace_ray(rays.at[index]); }
}
