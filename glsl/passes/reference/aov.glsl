// Stores the AOVs of a pixel, whose table is solari_vk/passes/first_hits.py.
#ifndef PASSES_REFERENCE_AOV_GLSL
#define PASSES_REFERENCE_AOV_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "passes/reference/bindings.glsl"
#include "scene/surface.glsl"

layout(constant_id = has_motion_id) const bool has_motion = false;

// The index of an instance within its world, from its row in `instances`.
uint instance_number(uint row) {
#ifdef MANY_VIEWS
    return row - views.at[view_index].first_instance;
#else
    return row;
#endif
}

void store_empty_aovs(uint index) {
    STORE_NO_FIRST_HITS(index)
}

// `mesh` is the one that hit.triangle is of: the instance's mesh, or its ray mesh.
void store_aovs(uint index, CameraRay ray, Hit hit, Mesh mesh) {
    SurfaceInteraction surface =
        resolve_surface_interaction(hit, mesh, ray.direction, ray.cone_width + ray.cone_spread * hit.t);
    move_to_ray(surface, ray.origin, hit.t * ray.direction);
    STORE_FIRST_HITS(index)
}

#endif
