// Flat mirrors as reflections of space: a surface seen in a chain of mirrors has a virtual position behind the first
// one.
#ifndef PASSES_GUIDES_MIRRORS_GLSL
#define PASSES_GUIDES_MIRRORS_GLSL

#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"

// The plane of a surface. A mirror reflects points by Householder's reflection, x - 2 n (n . (x - point)).
struct SurfacePlane {
    vec3 point;
    vec3 normal;
};

// The chain of reflections with one more mirror at its end.
mat4x3 append_mirror(mat4x3 chain, SurfacePlane mirror) {
    vec3 n = mirror.normal;
    mat3 householder = mat3(1.0) - 2.0 * mat3(n * n.x, n * n.y, n * n.z);
    vec3 moved = 2.0 * dot(n, mirror.point) * n;
    mat3 turn = mat3(chain) * householder;
    return mat4x3(turn[0], turn[1], turn[2], mat3(chain) * moved + chain[3]);
}

// The plane of an instance's surface in the previous frame. Its normal moves by the cofactor matrix.
SurfacePlane previous_plane(uint instance_index, SurfacePlane plane) {
    Instance instance = instances.at[instance_index];
    PreviousInstance previous = previous_instances.at[instance_index];
    if (previous.id != instance.id || previous.world_from_object == instance.world_from_object) { return plane; }
    mat4x3 m = previous.world_from_object;
    mat3 turn = mat3(instance.world_from_object);
    vec3 object_point = inverse(turn) * (plane.point - instance.world_from_object[3]);
    vec3 object_normal = plane.normal * turn;
    mat3 cofactors = mat3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    return SurfacePlane(m * vec4(object_point, 1.0), safe_normalize(cofactors * object_normal, plane.normal));
}

// The position of a hit point in the previous frame.
vec3 previous_hit_position(Hit hit, vec3 world_position) {
    Mesh mesh = meshes.at[instances.at[hit.instance].ray_mesh];
    return previous_world_position(hit, mesh, interpolate_position(mesh.positions, mesh, hit), world_position);
}

#endif
