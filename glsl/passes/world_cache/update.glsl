// The active cells that are updated in this frame, and their random numbers.
#ifndef PASSES_WORLD_CACHE_UPDATE_GLSL
#define PASSES_WORLD_CACHE_UPDATE_GLSL

#include "passes/world_cache/map.glsl"

const uint UPDATE_SALT = 0x7C0A11EDu;

// Seeds by the key, since a cell's index in the map depends on the order in which cells were inserted.
uint seed_cell_rng(uint cell, uint salt) {
    return seed_rng(uvec2(world_cache_checksums.at[cell], 0u), all_views.index, all_views.seed ^ salt);
}

// Of all views.
float pixel_count() {
    return float(camera.size.x) * float(camera.size.y) * float(view_count());
}

// The number of cells that a frame updates on average.
float update_cap() {
    float max_samples = float(world_cache_settings.max_samples);
    float cap = float(world_cache_settings.update_cap);
    // Edits that change so little outdate no mean.
    if (all_views.lighting_change == 0.0 && all_views.expected_change * max_samples <= 1.0) {
        cap = min(cap, world_cache_settings.updates_per_pixel * pixel_count());
    }
    return cap;
}

// The cell that a thread updates, or NO_INDEX. Above the cap a random subset is updated, the same one in all passes.
uint find_cell_to_update(uint thread) {
    if (thread >= world_cache_counters.active_cells) { return NO_INDEX; }
    uint cell = world_cache_active_cells.at[thread];
    uint rng = seed_cell_rng(cell, UPDATE_SALT);
    bool chosen = rand_f(rng) * float(world_cache_counters.active_cells) < update_cap();
    return chosen ? cell : NO_INDEX;
}

#endif
