// Spheres under a headlight: each box that a ray meets holds one, and where the ray meets it is computed here.
#version 460
#include "scene/ray_query.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) uniform UniformsBlock { uvec2 size; } view;
layout(set = 1, binding = 1, scalar) readonly buffer SpheresBlock { vec4 at[]; } spheres;
layout(set = 1, binding = 2, scalar) writeonly buffer PictureBlock { vec3 at[]; } picture;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, view.size))) { return; }
    vec2 screen = (2.0 * (vec2(pixel) + 0.5) - vec2(view.size)) / float(view.size.y);
    vec3 origin = vec3(0.0, 0.0, 5.0), direction = normalize(vec3(screen * vec2(0.6, -0.6), -1.0));

    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, RayDesc(RAY_FLAG_NONE, 0xFFu, 0.0, 1e6, origin, direction));
    while (rayQueryProceed(query)) {
        vec4 sphere = spheres.at[rayQueryGetCandidateIntersection(query).primitive_index];
        vec3 to_center = sphere.xyz - origin;
        float along = dot(to_center, direction);
        vec3 beside = to_center - along * direction;
        float depth = sphere.w * sphere.w - dot(beside, beside);
        if (depth >= 0.0 && along > sqrt(depth)) { rayQueryGenerateIntersection(query, along - sqrt(depth)); }
    }
    RayIntersection hit = rayQueryGetCommittedIntersection(query);
    vec3 color = vec3(0.02);
    if (hit.kind == RAY_QUERY_INTERSECTION_GENERATED) {
        vec4 sphere = spheres.at[hit.primitive_index];
        vec3 normal = (origin + hit.t * direction - sphere.xyz) / sphere.w;
        color = (0.5 + 0.5 * normal) * max(-dot(normal, direction), 0.0);
    }
    picture.at[pixel.y * view.size.x + pixel.x] = color;
}
