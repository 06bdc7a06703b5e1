// How rays leave surfaces: above them, or through glass below them.
#ifndef SCENE_DEPARTURE_GLSL
#define SCENE_DEPARTURE_GLSL

#include "scene/alpha.glsl"
#include "scene/hit.glsl"
#include "scene/surface.glsl"

// What absorbs light on the other side of a surface than that from which it is seen, per meter.
vec3 absorption_below(ResolvedMaterial material) {
    return material.lobes.solid && !material.lobes.inside ? material.lobes.absorption : vec3(0.0);
}

// What a ray that has hit a wall of glass carries: such rays are those that haven't passed it straight.
void take_wall_as_met(Hit hit, vec3 direction, inout ResolvedMaterial material, inout vec3 throughput) {
    if (!SCENE_GLASS || (materials.at[instances.at[hit.instance].material].flags & MATERIAL_WALL) == 0u) { return; }
    vec4 cover = resolve_cover(hit.instance, hit.triangle, hit.barycentrics, direction, false);
    if (cover.w < 1.0) {
        throughput /= cover.w;
        material.lobes.passed_straight = true;
    }
}

// Where rays that go in a direction leave a surface.
vec3 ray_origin(ResolvedRayHitFull surface, vec3 direction) {
    bool through = SCENE_GLASS && dot(direction, surface.geometric_world_normal) < 0.0;
    float offset = through ? -surface.ray_offset : surface.ray_offset;
    return surface.world_position + offset * surface.geometric_world_normal;
}

// Whether a direction is possible: above the surface, or through glass below it, for its shading normal and for its
// geometric normal. `height` is its cosine with the shading normal.
bool is_possible(float height, vec3 direction, vec3 geometric_normal) {
    float geometric = dot(direction, geometric_normal);
    return (height > 0.0 && geometric > 0.0) || (SCENE_GLASS && height < 0.0 && geometric < 0.0);
}

#endif
