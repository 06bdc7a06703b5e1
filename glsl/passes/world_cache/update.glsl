// The active cells that are updated in this frame, and their random numbers.
#ifndef PASSES_WORLD_CACHE_UPDATE_GLSL
#define PASSES_WORLD_CACHE_UPDATE_GLSL

#include "passes/world_cache/map.glsl"

const uint UPDATE_SALT = 0x7C0A11EDu, ROUND_SALT = 0x9E3779B9u;

// Whether this round is one of the fill, not the last one, in which each frame updates cells.
bool is_filling() { return world_cache_dispatch.rounds_left > 0u; }

// The place in the list of active cells that a thread of this round has.
uint place_in_list(uint thread) { return world_cache_dispatch.first_cell + thread; }

// Seeds by the key, since a cell's index in the map depends on the order in which cells were inserted.
uint seed_cell_rng(uint cell, uint salt) {
    salt ^= world_cache_dispatch.rounds_left * ROUND_SALT;
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

// The cell to update at a place of the list, or NO_INDEX. Above the cap a random subset is updated, the same one in all
// passes.
uint find_cell_to_update(uint place) {
    if (place >= world_cache_counters.active_cells) { return NO_INDEX; }
    uint cell = world_cache_active_cells.at[place];
    uint rng = seed_cell_rng(cell, UPDATE_SALT);
    bool chosen = rand_f(rng) * float(world_cache_counters.active_cells) < update_cap();
    return chosen ? cell : NO_INDEX;
}

#endif
