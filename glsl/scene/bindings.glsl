// Descriptor set 0: what is in the world. solari_vk/scene/binder.py fills it, by these names.
#ifndef SCENE_BINDINGS_GLSL
#define SCENE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_nonuniform_qualifier : require

#include "generated/scene/constants.glsl"

// ---- geometry: read only, one set of addresses a mesh, so no pool limits a scene's size ------------

struct VertexAttributes {
    vec3 normal;
    vec4 tangent;  // w: handedness of the bitangent
    vec2 uv;
};

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Positions { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Attributes { VertexAttributes at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Triangles { uvec3 at[]; };

struct Mesh {
    Positions positions;
    Attributes attributes;
    Triangles triangles;
    uint triangle_count;
    uint flags;
    vec3 least;  // corner of the bounds in object space
    vec3 most;   // the other
};

struct Instance {
    mat4x3 world_from_object;
    uint mesh;         // drawn by raster; NO_INDEX: nothing is
    uint ray_mesh;     // met by rays
    uint material;
    uint light_index;  // into light_sources, NO_INDEX when the instance emits nothing
    uint id;           // never used again, unlike rows; 0: none
};

// ---- materials --------------------------------------------------------------------------------------

struct Material {
    vec3 base_color;
    float perceptual_roughness;
    vec3 emissive;      // radiance
    float metallic;
    vec3 reflectance;   // F0 of the dielectric is 0.16 times its square
    float normal_scale;
    uint base_color_texture;          // into textures, or NO_INDEX
    uint metallic_roughness_texture;
    uint emissive_texture;
    uint normal_texture;
    uint flags;
};

struct Texture {
    mat3x2 uv_transform;  // applied to (u, v, 1)
    uint image;           // into texture_images
};

// ---- lights -----------------------------------------------------------------------------------------

struct LightSource {
    uint kind;   // row of LIGHT_KINDS in solari_vk/scene/light_kinds.py
    uint index;  // of the light's record in the buffer of its kind; of emissive meshes, of the instance
};

layout(set = 0, binding = 1, scalar) readonly buffer InstancesBlock { Instance at[]; } instances;
layout(set = 0, binding = 2, scalar) readonly buffer MeshesBlock { Mesh at[]; } meshes;
layout(set = 0, binding = 3, scalar) readonly buffer MaterialsBlock { Material at[]; } materials;
layout(set = 0, binding = 4, scalar) readonly buffer TexturesBlock { Texture at[]; } textures;
layout(set = 0, binding = 5, scalar) readonly buffer LightSourcesBlock { LightSource at[]; } light_sources;
layout(set = 0, binding = 7, scalar) readonly buffer SceneInfoBlock {
    uint light_count;
    uint first_light_at_infinity;  // index into light_sources, where lights at infinity come last
} scene_info;
layout(set = 0, binding = 63) uniform sampler2D texture_images[];  // the largest number of the set, as it has no length

#endif
