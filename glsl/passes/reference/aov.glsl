// The values of the AOVs of a pixel.
#ifndef PASSES_REFERENCE_AOV_GLSL
#define PASSES_REFERENCE_AOV_GLSL

#include "passes/reference/bindings.glsl"
#include "scene/surface.glsl"

// The index of an instance within its world, from its row in `instances`.
uint instance_number(uint row) {
#ifdef MANY_VIEWS
    return row - views.at[view_index].first_instance;
#else
    return row;
#endif
}

void store_empty_aovs(uint index) {
    aov_instance_id.at[index] = NO_INDEX;
    aov_depth.at[index] = INFINITY;
    aov_distance.at[index] = INFINITY;
    aov_position.at[index] = vec3(0.0);
    aov_geometric_normal.at[index] = vec3(0.0);
    aov_shading_normal.at[index] = vec3(0.0);
    aov_albedo.at[index] = vec3(0.0);
    aov_roughness_metallic.at[index] = vec2(0.0);
    aov_emissive.at[index] = vec3(0.0);
    aov_camera_normal.at[index] = vec3(0.0);
    aov_uv.at[index] = vec2(0.0);
    aov_material_id.at[index] = NO_INDEX;
}

// `mesh` is the one that hit.triangle is of: the instance's mesh, or its ray mesh.
void store_aovs(uint index, CameraRay ray, Hit hit, Mesh mesh) {
    SurfaceInteraction surface =
        resolve_surface_interaction(hit, mesh, ray.direction, ray.cone_width + ray.cone_spread * hit.t);
    aov_instance_id.at[index] = instance_number(hit.instance);
    aov_depth.at[index] = hit.t * ray.depth_per_t;
    aov_distance.at[index] = hit.t;
    aov_position.at[index] = surface.world_position;
    aov_geometric_normal.at[index] = surface.geometric_world_normal;
    aov_shading_normal.at[index] = surface.world_normal;
    aov_albedo.at[index] = surface.material.base.color;
    aov_roughness_metallic.at[index] = vec2(surface.material.base.perceptual_roughness, surface.material.base.metallic);
    aov_emissive.at[index] = shown_emission(surface);
    aov_camera_normal.at[index] = surface.world_normal * mat3(camera.world_from_view) * Y_UP;
    aov_uv.at[index] = texture_point(mesh, mesh.triangles.at[hit.triangle], hit.barycentrics).uv;
    aov_material_id.at[index] = instances.at[hit.instance].material;
}

#endif
