// What rays pass through: surfaces that are cut out by their alpha (alpha mode "mask"), and blended ones ("blend").
//
// A ray that looks for a surface hits a blended one with the probability alpha. Light that passes takes its color: with
// the weight alpha the base color, otherwise none. All of this light is tinted but that which goes to the camera
// directly, since glTF blends the picture of a surface over what lies behind it.
#ifndef SCENE_ALPHA_GLSL
#define SCENE_ALPHA_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/textures.glsl"

// The base color, and in w how much of the surface is there: 0 or 1 for opaque surfaces and masks. Textures are sampled
// at their finest level for every ray, so that all rays meet the same surface.
vec4 resolve_cover(Material material, Mesh mesh, uint triangle, vec2 barycentrics) {
    // The previous TLAS may have a triangle of a mesh that has left this row of the tables.
    uvec3 vertices = mesh.triangles.at[min(triangle, mesh.triangle_count - 1u)];
    vec4 color = vec4(material.base_color, material.alpha) * vertex_color(mesh, vertices, barycentrics);
    if (material.base_color_texture != NO_INDEX) {
        color *= sample_texture(material.base_color_texture, texture_point(mesh, vertices, barycentrics));
    }
    if ((material.flags & MATERIAL_MASK) != 0u) { color.w = color.w >= material.alpha_cutoff ? 1.0 : 0.0; }
    return color;
}

bool has_alpha(Material material) {
    return SCENE_ALPHA && (material.flags & (MATERIAL_MASK | MATERIAL_BLEND)) != 0u;
}

// At a candidate of a ray. Rays through the previous TLAS may meet instances that are gone: these count as opaque.
vec4 resolve_cover(uint instance_index, uint triangle, vec2 barycentrics) {
    Instance instance = instances.at[instance_index];
    Material material = materials.at[instance.material];
    if (instance.mesh == NO_INDEX || !has_alpha(material)) { return vec4(0.0, 0.0, 0.0, 1.0); }
    return resolve_cover(material, meshes.at[instance.ray_mesh], triangle, barycentrics);
}

// Whether a ray that looks for a surface hits one with this cover. The same seed gives the same answer for a triangle.
bool is_met(vec4 cover, uint seed, uint instance_index, uint triangle) {
    if (cover.w >= 1.0) { return true; }
    if (!SCENE_BLEND) { return false; }
    return unit_float(pcg4d(uvec4(seed, instance_index, triangle, 0x5F3759DFu)).x) < cover.w;
}

// ---- light that passes ------------------------------------------------------------------------------

// What happens to light along a segment: it passes with a probability, and takes a color.
struct Passage {
    vec3 tint;
    float probability;
};

const Passage FREE_PASSAGE = Passage(vec3(1.0), 1.0);

void pass_through(inout Passage passage, vec4 cover) {
    passage.tint *= mix(vec3(1.0), cover.rgb, cover.w);
    passage.probability *= 1.0 - cover.w;
}

#endif
