// Moves the vertices of meshes to their instances' poses: morph targets, then linear blend skinning, as in glTF.
// Magnenat-Thalmann, Laperriere and Thalmann, "Joint-Dependent Local Deformations for Hand Animation and Object
// Grasping" (Graphics Interface 1988).
//
// The host gives all memory by address (scene_poses.py) and puts barriers around this shader itself.
#version 460
#include "common/math.glsl"
#include "scene/posed.glsl"

layout(local_size_x = 64) in;

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer PosedMeshes { PosedMesh at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Joints { Joint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer ActiveTargets { ActiveTarget at[]; };

layout(push_constant, scalar) uniform Work {
    PosedMeshes meshes;
    Joints joints;
    ActiveTargets targets;
    uint first_mesh;
} work;

vec3 load(Given values, uint at) { return vec3(values.at[at], values.at[at + 1u], values.at[at + 2u]); }

void store(Made values, uint at, vec3 value) {
    for (uint i = 0u; i < 3u; i++) { values.at[at + i] = value[i]; }
}

mat4x3 blend_joints(PosedMesh mesh, uint vertex) {
    mat4x3 blended = mat4x3(0.0);
    bool moved = false;
    for (uint i = 0u; i < mesh.influence_count; i++) {
        Influence influence = mesh.influences.at[vertex * mesh.influence_count + i];
        if (influence.weight == 0.0) { continue; }
        blended += influence.weight * work.joints.at[mesh.first_joint + influence.joint].object_from_bind;
        moved = true;
    }
    return moved ? blended : mat4x3(1.0);
}

void main() {
    PosedMesh mesh = work.meshes.at[work.first_mesh + gl_WorkGroupID.y];
    uint vertex = gl_GlobalInvocationID.x;
    if (vertex >= mesh.vertex_count) { return; }
    uint attributes = vertex * mesh.attribute_width;
    bool has_normal = mesh.normal != NO_PART, has_tangent = mesh.tangent != NO_PART;
    vec3 position = load(mesh.rest_positions, 3u * vertex), normal = vec3(0.0), tangent = vec3(0.0);
    if (has_normal) { normal = load(mesh.rest_attributes, attributes + mesh.normal); }
    if (has_tangent) { tangent = load(mesh.rest_attributes, attributes + mesh.tangent); }
    vec3 rest_normal = normal, rest_tangent = tangent;
    for (uint i = 0u; i < mesh.target_count; i++) {
        ActiveTarget added = work.targets.at[mesh.first_target + i];
        uint at = (added.target * mesh.vertex_count + vertex) * mesh.target_width;
        position += added.weight * load(mesh.targets, at);
        if (mesh.target_normal != 0u) { normal += added.weight * load(mesh.targets, at + mesh.target_normal); }
        if (mesh.target_tangent != 0u) { tangent += added.weight * load(mesh.targets, at + mesh.target_tangent); }
    }
    if (mesh.influence_count > 0u) {
        mat4x3 joint = blend_joints(mesh, vertex);
        position = joint * vec4(position, 1.0);
        // The cofactor matrix turns normals like the inverse transpose, and exists for singular joints too.
        normal = mat3(cross(joint[1], joint[2]), cross(joint[2], joint[0]), cross(joint[0], joint[1])) * normal;
        tangent = mat3(joint) * tangent;
    }
    store(mesh.positions, 3u * vertex, position);
    if (has_normal) { store(mesh.attributes, attributes + mesh.normal, safe_normalize(normal, rest_normal)); }
    if (has_tangent) { store(mesh.attributes, attributes + mesh.tangent, safe_normalize(tangent, rest_tangent)); }
}
