// Fetches and projects a vertex of an instance's raster mesh, with reversed depth, which is 0 at infinity.
#version 460
#include "passes/bindings.glsl"
#include "scene/bindings.glsl"
#include "scene/camera.glsl"

layout(location = 0) flat out uint row;
layout(location = 1) flat out uint triangle;

void main() {
    Instance instance = instances.at[gl_InstanceIndex];
    Mesh mesh = meshes.at[instance.mesh];
    row = gl_InstanceIndex;
    triangle = gl_VertexIndex / 3;
    uint corner = gl_VertexIndex % 3;
    // Reverses the triangles of mirrored instances and cameras, so that all fronts run counter-clockwise.
    bool mirrored = determinant(mat3(camera.view_from_world) * mat3(instance.world_from_object)) < 0.0;
    if (mirrored && corner != 0u) { corner = 3u - corner; }
    vec3 object_position = mesh.positions.at[mesh.triangles.at[triangle][corner]];
    vec3 world_position = instance.world_from_object * vec4(object_position, 1.0);
    vec3 view = mat3(camera.view_from_world) * (world_position - camera.world_from_view[3]);
    vec2 jitter = 2.0 * camera.jitter / vec2(camera.size);
    vec2 across = view.xy * vec2(1.0, -1.0) / camera.tan_half_fov;
    if (is_orthographic(camera)) {
        gl_Position = vec4(across - jitter, 1.0 + (view.z + camera.near) / camera.orthographic_range, 1.0);
    } else {
        gl_Position = vec4(across + jitter * view.z, camera.near, -view.z);
    }
}
