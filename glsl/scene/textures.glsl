// Attributes of a mesh's vertices between the corners of a triangle, and textures at such a point.
#ifndef SCENE_TEXTURES_GLSL
#define SCENE_TEXTURES_GLSL

#include "scene/bindings.glsl"

// Where a surface point lies on its textures.
struct TexturePoint {
    vec2 uv;              // in the first set
    float footprint_lod;  // the base-2 logarithm of the width of the ray's footprint there
    float surface_lod;    // the same on the surface, over the square root of the triangle's area
    // What textures of other sets need, in scenes that have some.
    Mesh mesh;
    uvec3 vertices;
    vec2 barycentrics;
};

const float FINEST_LOD = -1000.0;

// Textures of a set that a mesh lacks use the first one.
bool uses_more_uvs(Mesh mesh, uint uv_set) {
    return SCENE_SECOND_UVS && uv_set > 0u && uv_set <= mesh.more_uv_sets;
}

bool has_uvs(Mesh mesh, uint uv_set) {
    return uses_more_uvs(mesh, uv_set) || (mesh.flags & MESH_HAS_UVS) != 0u;
}

vec2 vertex_uv(Mesh mesh, uint vertex, uint uv_set) {
    if (uses_more_uvs(mesh, uv_set)) { return mesh.more_uvs.at[(uv_set - 1u) * mesh.vertex_count + vertex]; }
    return mesh.attributes.at[vertex].uv;
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

// The footprint's narrow axis: the long axis would blur at grazing angles, and a pixel's samples average along it.
float footprint_lod(mat2 uv_edges, float surface_lod) {
    float uv_area = 0.5 * abs(determinant(uv_edges));
    return 0.5 * log2(max(uv_area, 1e-30)) + surface_lod;
}

// Without a footprint: textures are sampled at their finest level.
TexturePoint texture_point(Mesh mesh, uvec3 vertices, vec2 barycentrics) {
    vec2 uv = interpolated_uv(mesh, vertices, barycentrics, 0u);
    return TexturePoint(uv, FINEST_LOD, FINEST_LOD, mesh, vertices, barycentrics);
}

// The point in another set of uvs than the first, if the mesh has it. Little code, since it is inlined at each texture.
TexturePoint in_uv_set(TexturePoint point, uint uv_set) {
    if (uv_set > point.mesh.more_uv_sets) { return point; }
    uvec3 vertices = point.vertices + (uv_set - 1u) * point.mesh.vertex_count;
    vec2 uv = point.mesh.more_uvs.at[vertices.x];
    mat2 edges = mat2(point.mesh.more_uvs.at[vertices.y] - uv, point.mesh.more_uvs.at[vertices.z] - uv);
    point.uv = uv + edges * point.barycentrics;
    if (point.footprint_lod != FINEST_LOD) { point.footprint_lod = footprint_lod(edges, point.surface_lod); }
    return point;
}

vec4 vertex_color(Mesh mesh, uvec3 vertices, vec2 barycentrics) {
    if (!SCENE_VERTEX_COLORS || (mesh.flags & MESH_HAS_COLORS) == 0u) { return vec4(1.0); }
    vec4 color = mesh.colors.at[vertices.x];
    return color + barycentrics.x * (mesh.colors.at[vertices.y] - color)
        + barycentrics.y * (mesh.colors.at[vertices.z] - color);
}

#ifdef TEXTURES_IN_BUFFERS
#include "scene/texel_buffers.glsl"
#define TEXTURE_SIZE(source) (source).size
#define SAMPLE_TEXTURE(source, uv, lod) sample_texels(source, uv, lod)
#else
#define TEXTURE_SIZE(source) textureSize(texture_images[nonuniformEXT((source).image)], 0)
#define SAMPLE_TEXTURE(source, uv, lod) textureLod(texture_images[nonuniformEXT((source).image)], uv, lod)
#endif

vec4 sample_texture(uint texture_index, TexturePoint point) {
    Texture source = textures.at[texture_index];
    if (SCENE_SECOND_UVS && source.uv_set > 0u) { point = in_uv_set(point, source.uv_set); }
    float lod = point.footprint_lod;
    if (lod != FINEST_LOD) {
        vec2 scale = vec2(TEXTURE_SIZE(source));
        float uv_scale = abs(determinant(mat2(source.uv_transform)));
        lod += 0.5 * log2(max(uv_scale * scale.x * scale.y, 1e-30));
    }
    return SAMPLE_TEXTURE(source, source.uv_transform * vec3(point.uv, 1.0), lod);
}

#endif
