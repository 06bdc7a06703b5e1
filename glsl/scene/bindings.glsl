// Descriptor set 0: the scene. solari_vk/bound/binder.py fills it, by these names.
#ifndef SCENE_BINDINGS_GLSL
#define SCENE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_buffer_reference_uvec2 : require
#extension GL_EXT_nonuniform_qualifier : require

// generated/X.glsl is what glsl_header() of solari_vk/X.py returns. SCENE_X is a constant: whether the scene has the
// feature X, a row of solari_vk/bound/features.py; the code of features that it lacks costs nothing.
// SCENE_LAYERS: a coat, sheen, anisotropy or a specular weight; SCENE_LOBES: layers, glass, diffuse transmission or a
// film; SCENE_TRANSMISSION: glass or diffuse transmission; SCENE_BLEND: alpha mode "blend", or smooth thin-walled
// glass; SCENE_ALPHA: that, or alpha mode "mask"; SCENE_SMOOTH_NORMALS: triangles with corners of different normals;
// SCENE_LARGE: triangles that may be so large that positions by barycentrics are too coarse. MATERIAL_SOLID: the
// surface bounds a solid, which light may enter and which absorbs it. MATERIAL_WALL: thin-walled glass, smooth at least
// in places.
#include "generated/bound/constants.glsl"  // NO_INDEX, struct Material, MESH_*, MATERIAL_*, WITHOUT_*, masks of rays
#include "generated/bound/features.glsl"  // SCENE_*
#ifdef MANY_VIEWS
#include "scene/camera_block.glsl"
#endif

// ---- geometry: each mesh has its own addresses, so no pool limits the size of a scene ---------------

struct VertexAttributes {
    vec3 normal;
    vec4 tangent;  // w: handedness of the bitangent
    vec2 uv;
};

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Positions { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Attributes { VertexAttributes at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Triangles { uvec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer MoreUvs { vec2 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Colors { vec4 at[]; };

struct Mesh {
    Positions positions;
    Positions previous_positions;  // in the previous frame; the same buffer for a mesh that doesn't change its pose
    Attributes attributes;
    Triangles triangles;
    MoreUvs more_uvs;  // of the second set, of the third, and so on: each of all vertices
    Colors colors;
    uint triangle_count;
    uint vertex_count;
    uint more_uv_sets;   // besides the first one
    uint tangent_frame;  // of the textures that the tangents fit; 0: they fit all
    uint flags;
    vec3 bounds_min;  // in object space
    vec3 bounds_max;
};

struct Instance {
    mat4x3 world_from_object;
    uint mesh;         // drawn by raster, or NO_INDEX
    uint ray_mesh;     // intersected by rays
    uint material;
    uint light_index;  // into light_sources, or NO_INDEX when the instance emits nothing
    uint id;           // unlike the row, never given to another instance; 0 in unused rows
};

// ---- materials --------------------------------------------------------------------------------------

// struct Material is generated from the fields of solari_vk/scene/material.py.

struct Texture {
    mat3x2 uv_transform;  // applied to (u, v, 1)
    uint image;           // into texture_images
    uint uv_set;
    uint tangent_frame;   // differs where the tangents along u do
#ifdef TEXTURES_IN_BUFFERS
    // In place of an image: TexelBuffer of solari_vk/bound/texture_table.py.
    uvec2 texels;  // the address of Words: 8 bits of red, green, blue and alpha, row by row, from the finest level on
    ivec2 size;
    uint level_count;
    uvec2 wrap;
    uint magnifies_linearly;
    uint minifies_linearly;
    uint is_srgb;
#endif
};

// ---- lights -----------------------------------------------------------------------------------------

// A row of an alias table: solari_vk/bound/lights/alias_table.py.
struct AliasTableRow {
    uint threshold;     // random 32-bit numbers below it choose this row, all others choose `alias`
    uint alias;
    float probability;  // that this row is chosen, by itself or as an alias
};

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer AliasTable { AliasTableRow at[]; };

struct LightSource {
    // A light sample takes one part of a light: a triangle of an emissive mesh (of its ray mesh), or a texel of an
    // environment. Other lights have one part.
    // By part: a row of its leaf's alias table, whose aliases are parts too. Null where all parts of a leaf are equally
    // likely.
    AliasTable parts;
    uint part_count;
    uint kind;          // row of LIGHT_KINDS in solari_vk/bound/lights/light_kinds.py
    uint record_index;  // of the light's record in the buffer of its kind; for emissive meshes, of the instance
    uint first_leaf;    // into light_leaves; the light's others follow
    uint halvings;      // how often the parts are halved, in their order, to make the leaves; NO_INDEX: each is a leaf
};

// What light samples choose first: some neighboring triangles of an emissive mesh, or a light of another kind.
struct LightLeaf {
    AliasTableRow by_power;  // the leaf's row of the alias table of all leaves
    uint light;              // into light_sources
    uint node;               // the leaf in light_tree; NO_INDEX at infinity, or if it is the only leaf that isn't
    uint first_part;         // of the light's parts, of which the leaf has part_count
    uint part_count;
};

// A node of the tree over the leaves that are not at infinity: light_tree.py.
struct LightNode {
    vec3 center;
    vec3 half_size;  // of the bounds around the center
    float power;   // share of all lights in the tree
    uint child_count;
    uint first;    // child, which the others follow; without a child, the leaf's index in light_leaves
    uint parent;   // of the root: itself
};

layout(set = 0, scalar) readonly buffer InstancesBlock { Instance at[]; } instances;
layout(set = 0, scalar) readonly buffer MeshesBlock { Mesh at[]; } meshes;
layout(set = 0, scalar) readonly buffer MaterialsBlock { Material at[]; } materials;

// What decides, beside textures, how much of what is behind it a surface covers: the alpha of blended materials, and 2
// plus the texture's least alpha that covers of masked ones; else -1.
float opacity_of(uint index) {
    Material material = materials.at[index];
    if ((material.flags & MATERIAL_MASK) != 0u) { return 2.0 + material.alpha_cutoff / max(material.alpha, 1e-6); }
    return (material.flags & MATERIAL_BLEND) != 0u ? material.alpha : -1.0;
}
layout(set = 0, scalar) readonly buffer TexturesBlock { Texture at[]; } textures;
layout(set = 0, scalar) readonly buffer LightSourcesBlock { LightSource at[]; } light_sources;
layout(set = 0, scalar) readonly buffer LightLeavesBlock { LightLeaf at[]; } light_leaves;
layout(set = 0, scalar) readonly buffer LightTreeBlock { LightNode at[]; } light_tree;

// The lights of a scene. The worlds of a batch, which are scenes or variants of one (scene/camera_block.glsl), may have
// lights of their own, whose records follow those of the world before in all tables: solari_vk/batch/world_lights.py.
struct SceneInfo {
    uint light_count;
    uint leaf_count;
    uint part_count;               // of all light sources together
    uint first_leaf;               // into light_leaves
    uint light_root;               // into light_tree
    // Indices into light_sources: portals, lights that rays pass, and lights at infinity come last, in this order.
    uint first_portal;
    uint first_pass_through_light;
    uint first_light_at_infinity;
    uint light_end;                // one more than the last light
    uint first_environment;        // where the light of the first record in `environments` is
    uint first_portal_record;      // into `portals`
    float tree_probability;        // that a leaf of the tree is chosen by `by_power`
    vec3 origin;                   // from which coordinates count, in the scene's own: Scene.origin
    uint absent_features;          // WITHOUT_BLEND, WITHOUT_DISPERSION: features that only other worlds have
};

layout(set = 0, scalar) readonly buffer SceneInfoBlock { SceneInfo at[]; } scene_infos;
#ifdef MANY_VIEWS
#define scene_info scene_infos.at[world_index * views.has_own_lights]
#else
#define scene_info scene_infos.at[0]
#endif
// Whether a world takes random numbers for a feature: not if only other worlds of the batch have it, so that the world
// gives the same picture alone and in a batch.
bool uses_random_numbers_for(uint feature) { return (scene_info.absent_features & feature) == 0u; }
// Bindings 16 to 62 are free for the buffers of light kinds: scene/lights/. The texture array has the largest number,
// because it has no length.
#ifndef TEXTURES_IN_BUFFERS
layout(set = 0) uniform sampler2D texture_images[];
#endif

#endif
