// Paths from cells of the world cache.
#ifndef PASSES_WORLD_CACHE_CELL_PATH_GLSL
#define PASSES_WORLD_CACHE_CELL_PATH_GLSL

#include "passes/paths/pack_path.glsl"
#include "passes/world_cache/division.glsl"
#include "passes/world_cache/update.glsl"

// Adds what a path has found.
void add_to_cell(Path path, uint thread) { world_cache_samples.at[thread].irradiance += PI * path_light(path).diffuse; }

// Whether world_cache_paths has room for the paths of all cells. Else none is stored: the order of threads would decide
// which ones are, and since shaders round differently, a seed would no longer give one picture.
bool paths_have_room() {
    float most = min(float(world_cache_counters.active_cells), update_cap());
    return most + 8.0 * sqrt(most) < float(world_cache_paths.at.length());  // the number is random: 8 of its deviations
}

void store_cell_path(Path path, uint index) {
    world_cache_paths.at[index].state = pack_path(path);
    world_cache_paths.at[index].rays = pack_rays(path);
}

// Whether a path waits at this index of world_cache_paths. Sets world_index to the world of its cell.
bool find_cell_path(uint index) {
    uint count = min(world_cache_counters.updates, world_cache_paths.at.length());
    if (!paths_have_room() || index >= count || world_cache_paths.at[index].thread == NO_INDEX) { return false; }
#ifdef MANY_VIEWS
    world_index = world_cache_worlds.at[world_cache_active_cells.at[world_cache_paths.at[index].thread]];
#endif
    return true;
}

#endif
