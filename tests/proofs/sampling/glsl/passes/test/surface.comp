// MIS weights, bases, bent normals, and surfaces resolved from hits that are made up. MODE says which.
#version 460
#include "scene/surface.glsl"

layout(local_size_x = 64) in;

layout(set = 1, scalar) readonly buffer VectorsBlock { vec3 at[]; } vectors;  // three each
layout(set = 1, scalar) buffer ResultsBlock { vec3 at[]; } results;           // three each

float triangle_area(Hit hit) {
    Instance instance = instances.at[hit.instance];
    return resolve_triangle(instance, meshes.at[instance.ray_mesh], hit.triangle, hit.barycentrics).area;
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= results.at.length() / 3u) { return; }
    vec3 a = vectors.at[3u * i], b = vectors.at[3u * i + 1u], c = vectors.at[3u * i + 2u];
    mat3 result = mat3(0.0);
#if MODE == 0
    result[0] = vec3(balance_heuristic(a.x, a.y), power_heuristic(a.x, a.y), 0.0);
#elif MODE == 1
    result = orthonormalize(a);
#elif MODE == 2
    result[0] = bend_shading_normal(a, b, c);
#else
    Hit hit = Hit(1.0, uint(a.x), uint(a.y), b.xy, true);
    SurfaceInteraction surface = resolve_surface_interaction(hit, c, a.z);
    result = mat3(
        surface.world_normal, surface.geometric_world_normal,
        vec3(surface.ray_offset, triangle_area(hit), dot(surface.material.base.color, vec3(1.0)))
    );
#endif
    for (uint k = 0u; k < 3u; k++) { results.at[3u * i + k] = result[k]; }
}
