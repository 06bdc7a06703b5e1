// The point of a triangle that a pixel shows, computed as a ray would.
#ifndef PASSES_GBUFFER_RASTER_GLSL
#define PASSES_GBUFFER_RASTER_GLSL

#include "scene/camera.glsl"
#include "scene/hit.glsl"

// The point where the ray hits the triangle's plane, clamped to the triangle: raster coverage is exact to about 1/256
// of a pixel only.
Hit intersect_triangle(CameraRay ray, uint row, uint triangle, Mesh mesh) {
    Instance instance = instances.at[row];
    uvec3 corners = mesh.triangles.at[triangle];
    mat3 m = mat3(instance.world_from_object);
    vec3 corner = mesh.positions.at[corners.x];
    vec3 edge_1 = m * (mesh.positions.at[corners.y] - corner);
    vec3 edge_2 = m * (mesh.positions.at[corners.z] - corner);
    corner = instance.world_from_object * vec4(corner, 1.0) - ray.origin;
    vec3 perpendicular = cross(ray.direction, edge_2);
    float volume = dot(edge_1, perpendicular);
    vec2 barycentrics = vec2(1.0 / 3.0);
    if (volume != 0.0) {
        vec2 weights = -vec2(dot(corner, perpendicular), dot(ray.direction, cross(corner, edge_1))) / volume;
        barycentrics = clamp(weights, 0.0, 1.0);
        barycentrics /= max(barycentrics.x + barycentrics.y, 1.0);
    }
    vec3 point = corner + barycentrics.x * edge_1 + barycentrics.y * edge_2;
    return Hit(dot(point, ray.direction), row, triangle, barycentrics, true);
}

#endif
