// The G-buffer by raster: the surface at the pixel's centre on the triangle that covers it, as a ray would find it.
#version 460
#extension GL_EXT_ray_query : require
#include "passes/gbuffer/pixel.glsl"

layout(location = 0) flat in uint row;
layout(location = 1) flat in uint triangle;
layout(location = 0) out uvec4 out_gbuffer;
layout(location = 1) out uvec2 out_surface;
layout(location = 2) out float out_depth;
layout(location = 3) out vec2 out_motion;

// Where the ray meets the triangle's plane. Coverage is exact to 1/256 of a pixel or so only, so the point is kept inside.
Hit intersect_triangle(CameraRay ray, Instance instance, Mesh mesh) {
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

void main() {
    CameraRay ray = make_camera_ray(gl_FragCoord.xy);
    Instance instance = instances.at[row];
    Mesh mesh = meshes.at[instance.mesh];
    GBufferPixel pixel = resolve_pixel(ray, intersect_triangle(ray, instance, mesh), mesh);
    out_gbuffer = pixel.gbuffer;
    out_surface = pixel.surface;
    out_depth = pixel.depth;
    out_motion = pixel.motion;
}
