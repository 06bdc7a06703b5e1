// Paths from cells of the world cache.
#ifndef PASSES_WORLD_CACHE_CELL_PATH_GLSL
#define PASSES_WORLD_CACHE_CELL_PATH_GLSL

#include "passes/paths/pack_path.glsl"
#include "passes/world_cache/division.glsl"
#include "passes/world_cache/update.glsl"

// Adds what a path has found.
void add_to_cell(Path path, uint thread) { world_cache_samples.at[thread].irradiance += PI * path_light(path).diffuse; }

// Where passes of their own trace: whether a thread has a path. Chooses the world of its cell.
bool find_cell_path(uint index) {
    if (index >= min(world_cache_counters.updates, world_cache_paths.at.length())) { return false; }
#ifdef MANY_VIEWS
    world_index = world_cache_worlds.at[world_cache_active_cells.at[world_cache_paths.at[index].thread]];
#endif
    return true;
}

#endif
