// World cache, step 1: removes cells that were not queried for their lifetime, takes the point that represents each
// other cell from a query of the previous frame, and counts the cells of each block that may be updated.
#version 460
#include "generated/passes/world_cache.glsl"  // BLOCK_SIZE, written by solari_vk/passes/world_cache.py
#include "passes/light_change.glsl"
#include "passes/world_cache/map.glsl"

layout(local_size_x = GROUP_SIZE) in;

void clear_cell(uint cell) {
    world_cache_checksums.at[cell] = EMPTY_CELL;
    world_cache_life.at[cell] = 0u;
    world_cache_irradiance.at[cell] = vec4(0.0);
    world_cache_luminance_deltas.at[cell] = 0.0;
    world_cache_votes.at[cell] = WorldCachePoint(0u, 0u);
    world_cache_first_points.at[cell] = WorldCachePoint(0u, 0u);
}

// Whether most of a cell's light may have changed in this frame, and not before: a cell's own mean is noisy, and to
// forget the dark ones in frame after frame would make the cache too bright.
bool is_outdated(uint cell) {
    if (changed_lights.count == 0u) { return false; }
    vec4 bounds = world_cache_bounds.at[cell];
    float irradiance = luminance(world_cache_irradiance.at[cell].rgb);
    return light_change(bounds.xyz + 0.5 * bounds.w, irradiance, NEW_CHANGE) > 0.5;
}

// Differs from Solari: uses the known change of the lights instead of estimating it from noisy samples. The next update
// of a cell, which may be frames away, then replaces at least as large a share of its mean as the share of light that
// changed. When all light changed, or most of the light at the cell, the cell has no value until then.
void relight(uint cell) {
#ifdef MANY_VIEWS
    world_index = world_cache_worlds.at[cell];
    float share = changed_lights.fraction;
#else
    float share = this_frame.expected_change;
#endif
    float change = is_outdated(cell) ? 1.0 : share;
    if (change == 0.0) { return; }
    float sample_count = world_cache_irradiance.at[cell].w;
    world_cache_irradiance.at[cell].w = min(sample_count, (1.0 - change) / change);
}

void main() {
    bool relights = world_cache_settings.relight != 0u;
    uint block = thread_index(gl_GlobalInvocationID.xy);
    uint active_count = 0u;
    for (uint cell = block * BLOCK_SIZE; cell < (block + 1u) * BLOCK_SIZE; cell++) {
        if (world_cache_checksums.at[cell] == EMPTY_CELL) { continue; }
        uint life = world_cache_life.at[cell];
        if (life == 0u || all_views.has_history == 0u) {
            clear_cell(cell);
            continue;
        }
        world_cache_life.at[cell] = life - 1u;
        if (relights) { relight(cell); }
        if (!take_voted_point(cell)) {
            world_cache_points.at[cell].position = without_priority(world_cache_points.at[cell].position);
        }
        active_count += is_to_update(cell) ? 1u : 0u;
    }
    world_cache_blocks.at[block] = active_count;
    if (block == 0u) {
        world_cache_counters.updates = 0u;
        world_cache_counters.insert_failures = 0u;
    }
}
