// World cache, in each round of updates: chooses the cells that it updates. The rounds of the fill update those that
// request.comp has added to the list of active cells; the last round, which is that of a frame without a fill, all.
#version 460
#include "generated/passes/world_cache.glsl"  // FILL_SQUARE, written by solari_vk/passes/world_cache.py
#include "passes/world_cache/update.glsl"

layout(local_size_x = 1) in;

layout(constant_id = fill_rounds_id) const uint fill_rounds = 0u;

// The cache is cold if more than this share of the squares of pixels asks for cells without a value. Else the usual
// update is enough, by which cells have a value one frame after they are asked.
const float COLD_SHARE = 0.125;

void main() {
    uint added = world_cache_counters.active_cells - world_cache_dispatch.old_cells;
    bool first = world_cache_dispatch.rounds_left == fill_rounds + 1u;
    float squares = pixel_count() / float(FILL_SQUARE * FILL_SQUARE);
    if (first && float(world_cache_dispatch.misses) <= COLD_SHARE * squares) {
        world_cache_counters.active_cells -= added;
        added = 0u;
    }
    world_cache_dispatch.rounds_left -= 1u;
    world_cache_counters.updates = 0u;
    bool last = world_cache_dispatch.rounds_left == 0u;
    world_cache_dispatch.first_cell = last ? 0u : world_cache_dispatch.old_cells;
    world_cache_dispatch.size = make_indirect_dispatch(last ? world_cache_counters.active_cells : added, 1u);
}
