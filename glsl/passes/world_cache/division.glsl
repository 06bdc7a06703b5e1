// Finds cells of the world cache that a wall goes through. Differs from Solari, whose cells carry light through thin
// walls: here a cell is not used any more once one of its points doesn't see the cell's first point. Each update of a
// cell tests one point. Until a cell has been tested a few times, each point that asks the cell is tested too.
#ifndef PASSES_WORLD_CACHE_DIVISION_GLSL
#define PASSES_WORLD_CACHE_DIVISION_GLSL

#include "passes/ray_count.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/trace.glsl"

// Points see each other from this height above the surface, in cell sizes, so that bumps of the surface hide nothing.
const float EYE_HEIGHT = 0.05;

const float TESTED_SAMPLES = 1.99;  // a cell's effective samples after five updates: blend.comp adds 0.25 in each

bool sees_first_point(uint cell, vec3 world_position, vec3 normal) {
    WorldCacheSurface first = unpack_point(cell, world_cache_first_points.at[cell]);
    float height = EYE_HEIGHT * world_cache_bounds.at[cell].w;
    vec3 eye = world_position + height * normal;
    count_ray();
    return trace_visibility(eye, first.world_position + height * first.geometric_world_normal - eye, 1.0);
}

// Whether a cell may give its light to a point.
bool is_cell_open(uint cell, vec3 world_position, vec3 normal) {
    return world_cache_settings.leak_prevention != WORLD_CACHE_LEAK_PREVENTION_DIVIDED
        || world_cache_irradiance.at[cell].w > TESTED_SAMPLES || sees_first_point(cell, world_position, normal);
}

// Tests the point that represents the cell in this frame. The blend acts on it, when no pass asks the cell.
void test_for_wall(uint cell, uint thread) {
    if (world_cache_settings.leak_prevention != WORLD_CACHE_LEAK_PREVENTION_DIVIDED) { return; }
    WorldCacheSurface surface = load_world_cache_surface(cell);
    if (!sees_first_point(cell, surface.world_position, surface.geometric_world_normal)) {
        world_cache_samples.at[thread].life |= SEES_WALL;
    }
}

#endif
