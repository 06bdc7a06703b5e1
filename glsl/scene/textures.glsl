// Attributes of a mesh's vertices between the corners of a triangle, and textures at such a point.
#ifndef SCENE_TEXTURES_GLSL
#define SCENE_TEXTURES_GLSL

#include "scene/bindings.glsl"

// Where a surface point lies on its textures, for both sets of uvs: the coordinates, and the base-2 logarithm of the
// width of the ray's footprint there.
struct TexturePoint {
    vec2 uv, second_uv;
    float footprint_lod, second_footprint_lod;
};

const float FINEST_LOD = -1000.0;

// Textures of the second set use the first one on a mesh that has no second, in scenes with and without other meshes
// that have one.
bool uses_second_uvs(Mesh mesh, uint uv_set) {
    return SCENE_SECOND_UVS && uv_set == 1u && (mesh.flags & MESH_HAS_SECOND_UVS) != 0u;
}

bool has_uvs(Mesh mesh, uint uv_set) {
    return uses_second_uvs(mesh, uv_set) || (mesh.flags & MESH_HAS_UVS) != 0u;
}

vec2 vertex_uv(Mesh mesh, uint vertex, uint uv_set) {
    return uses_second_uvs(mesh, uv_set) ? mesh.second_uvs.at[vertex] : mesh.attributes.at[vertex].uv;
}

// The edges of a triangle from its first vertex in a set of uvs; 0 without uvs.
mat2 uv_edges(Mesh mesh, uvec3 vertices, uint uv_set) {
    if (!has_uvs(mesh, uv_set)) { return mat2(0.0); }
    vec2 uv = vertex_uv(mesh, vertices.x, uv_set);
    return mat2(vertex_uv(mesh, vertices.y, uv_set) - uv, vertex_uv(mesh, vertices.z, uv_set) - uv);
}

vec2 interpolated_uv(Mesh mesh, uvec3 vertices, vec2 barycentrics, uint uv_set) {
    if (!has_uvs(mesh, uv_set)) { return vec2(0.0); }
    mat2 edges = uv_edges(mesh, vertices, uv_set);
    return vertex_uv(mesh, vertices.x, uv_set) + barycentrics.x * edges[0] + barycentrics.y * edges[1];
}

// Without a footprint: textures are sampled at their finest level.
TexturePoint texture_point(Mesh mesh, uvec3 vertices, vec2 barycentrics) {
    vec2 uv = interpolated_uv(mesh, vertices, barycentrics, 0u), second_uv = vec2(0.0);
    if (SCENE_SECOND_UVS) { second_uv = interpolated_uv(mesh, vertices, barycentrics, 1u); }
    return TexturePoint(uv, second_uv, FINEST_LOD, FINEST_LOD);
}

vec4 vertex_color(Mesh mesh, uvec3 vertices, vec2 barycentrics) {
    if (!SCENE_VERTEX_COLORS || (mesh.flags & MESH_HAS_COLORS) == 0u) { return vec4(1.0); }
    vec4 color = mesh.colors.at[vertices.x];
    return color + barycentrics.x * (mesh.colors.at[vertices.y] - color)
        + barycentrics.y * (mesh.colors.at[vertices.z] - color);
}

vec4 sample_texture(uint texture_index, TexturePoint point) {
    Texture source = textures.at[texture_index];
    bool second = SCENE_SECOND_UVS && source.uv_set == 1u;
    vec2 uv = second ? point.second_uv : point.uv;
    float footprint_lod = second ? point.second_footprint_lod : point.footprint_lod;
    float lod = footprint_lod;
    if (footprint_lod != FINEST_LOD) {
        vec2 scale = vec2(textureSize(texture_images[nonuniformEXT(source.image)], 0));
        float uv_scale = abs(determinant(mat2(source.uv_transform)));
        lod += 0.5 * log2(max(uv_scale * scale.x * scale.y, 1e-30));
    }
    return textureLod(texture_images[nonuniformEXT(source.image)], source.uv_transform * vec3(uv, 1.0), lod);
}

#endif
