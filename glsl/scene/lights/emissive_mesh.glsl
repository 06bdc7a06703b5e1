// Lights that are instances with an emissive material: samples are points of their triangles. light_kinds.py says what
// the functions that end in _emissive_mesh do, and numbers the kind, LIGHT_EMISSIVE_MESH.
#ifndef SCENE_LIGHTS_EMISSIVE_MESH_GLSL
#define SCENE_LIGHTS_EMISSIVE_MESH_GLSL

#include "common/random.glsl"
#include "scene/alpha.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/types.glsl"
#include "scene/surface.glsl"

ResolvedLightSample resolve_emissive_mesh(uint index, uint part, vec2 u, float inverse_probability) {
    Instance instance = instances.at[index];
    Mesh mesh = meshes.at[instance.ray_mesh];
    Material material = materials.at[instance.material];
    vec2 barycentrics = sample_triangle_barycentrics(u);
    TrianglePoint point = resolve_triangle(instance, mesh, part, barycentrics);
    vec3 radiance = resolve_emissive(material, point.texture_point);
    if (has_alpha(material)) { radiance *= resolve_color_opacity(material, mesh, part, barycentrics).w; }
    return ResolvedLightSample(
        LIGHT_EMISSIVE_MESH,
        material.flags & MATERIAL_DOUBLE_SIDED,
        point.world_position,
        point.geometric_world_normal,
        point.ray_offset,
        radiance,
        inverse_probability * point.area
    );
}

float emission_cosine_emissive_mesh(uint double_sided, float cosine) {
    return max(cosine, double_sided != 0u ? -cosine : 0.0);
}

// The debug view of light samples chooses colors by this number, and that of instances by the id alike.
uint debug_color_id_emissive_mesh(uint index) { return instances.at[index].id; }

// The solid angle pdf of a light sample at a hit at distance `ray_t`, where leaves are chosen by power; 0 for a surface
// that is no light.
float emissive_hit_pdf(SurfaceInteraction hit, vec3 ray_direction, float ray_t) {
    float cosine = abs(dot(ray_direction, hit.geometric_world_normal));
    return hit.area_pdf_by_power > 0.0 && cosine > 0.0 ? square(ray_t) / cosine * hit.area_pdf_by_power : 0.0;
}

#endif
