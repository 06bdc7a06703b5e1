// Rays that leave a triangle, and shadow rays between two, must not meet the triangles that they start or end on.
#version 460
#include "common/random.glsl"
#include "scene/light_visibility.glsl"

layout(local_size_x = 64) in;

// hits of the ray's own triangle, of either end's by a shadow ray, offset / reach, NaNs
layout(set = 1, scalar) buffer CountsBlock { vec4 at[]; } counts;

bool meets(vec3 origin, float t_min, vec3 direction, float t_max, uint instance, uint triangle) {
    Hit hit = trace_closest_hit(origin, t_min, direction, t_max, TRACE_BOTH_FACES);
    return hit.instance == instance && hit.triangle == triangle;
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= counts.at.length()) { return; }
    uint rng = seed_rng(uvec2(i, 1u), 0u, 5u);
    uint first = i % GROUP_COUNT * GROUP_SIZE;
    uint index = first + rand_range_u(GROUP_SIZE, rng);
    Instance instance = instances.at[index];
    Mesh mesh = meshes.at[instance.ray_mesh];
    uint triangle = rand_range_u(mesh.triangle_count, rng);
    TrianglePoint point = resolve_triangle(instance, mesh, triangle, sample_triangle_barycentrics(rand_vec2f(rng)));
    float side = rand_f(rng) < 0.5 ? -1.0 : 1.0;
    vec3 normal = side * point.geometric_world_normal;
    vec3 origin = point.world_position + normal * point.ray_offset;
    vec3 local = sample_uniform_hemisphere(rand_vec2f(rng));
    if (rand_f(rng) < 0.3) { local.z *= 1e-3; }  // grazing
    vec3 direction = normalize(orthonormalize(normal) * local);
    bool own = dot(direction, normal) > 0.0 && meets(origin, 0.0, direction, INFINITY, index, triangle);

    // a light's point, as from a light sample, seen from there
    uint other_index = first + rand_range_u(GROUP_SIZE, rng);
    Instance other = instances.at[other_index];
    Mesh other_mesh = meshes.at[other.ray_mesh];
    uint other_triangle = rand_range_u(other_mesh.triangle_count, rng);
    vec2 barycentrics = sample_triangle_barycentrics(rand_vec2f(rng));
    TrianglePoint end = resolve_triangle(other, other_mesh, other_triangle, barycentrics);
    ResolvedLightSample light = ResolvedLightSample(
        LIGHT_EMISSIVE_MESH, 1u, end.world_position, end.geometric_world_normal, end.ray_offset, vec3(1.0), 1.0
    );
    vec3 segment = shadow_ray_segment(origin, light);
    bool same = index == other_index && triangle == other_triangle;
    bool above = dot(segment, normal) > 0.0;
    // the far end by itself: what stands between must not hide it
    bool ends = !same && above && (meets(origin, 0.0, segment, 1.0, index, triangle)
        || meets(origin, 0.999, segment, 1.0, other_index, other_triangle));
    bool broken = any(isnan(origin)) || any(isnan(direction)) || any(isnan(segment)) || !(point.ray_offset > 0.0);
    counts.at[i] = vec4(own, ends, point.ray_offset / (length(point.world_position) + 1e-30), broken);
}
