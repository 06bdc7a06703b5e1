// The world cache: a hash map of fixed size, with one element per cell in each buffer.
#ifndef PASSES_WORLD_CACHE_BINDINGS_GLSL
#define PASSES_WORLD_CACHE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/paths/stored_path.glsl"
#include "passes/rows.glsl"

#ifdef MANY_VIEWS
layout(set = 1, scalar) buffer WorldCacheWorldsBlock { uint at[]; } world_cache_worlds;  // which has the cell
const uint WORLD_SALT = 0x9E3779B9u;
#endif

// The surface point of a query: its position relative to the cell, and its octahedral normal. Each word has 8 bits of
// random priority above 24 bits of data, so that atomicMax picks one of the queries of a frame.
struct WorldCachePoint {
    uint position;
    uint normal;
};

layout(set = 1, scalar) buffer WorldCacheChecksumsBlock { uint at[]; } world_cache_checksums;  // 0: empty
layout(set = 1, scalar) buffer WorldCacheLifeBlock { uint at[]; } world_cache_life;  // frames left
// Mean irradiance; w is the effective number of samples in it.
layout(set = 1, scalar) buffer WorldCacheIrradianceBlock { vec4 at[]; } world_cache_irradiance;
// Minimum corner and size of the cell.
layout(set = 1, scalar) buffer WorldCacheBoundsBlock { vec4 at[]; } world_cache_bounds;
layout(set = 1, scalar) buffer WorldCacheVotesBlock { WorldCachePoint at[]; } world_cache_votes;
layout(set = 1, scalar) buffer WorldCachePointsBlock { WorldCachePoint at[]; } world_cache_points;
layout(set = 1, scalar) buffer WorldCacheDeltasBlock { float at[]; } world_cache_luminance_deltas;

// The first point of a cell's life, or DIVIDED_CELL: the cell is not used, because a wall goes through it.
const WorldCachePoint DIVIDED_CELL = WorldCachePoint(0xFFFFFFFFu, 0u);
layout(set = 1, scalar) buffer WorldCacheFirstPointsBlock {
    WorldCachePoint at[];
} world_cache_first_points;

// For each block of the map: its number of active cells, and after the scan the index of its first one in the list of
// active cells.
layout(set = 1, scalar) buffer WorldCacheBlocksBlock { uint at[]; } world_cache_blocks;
layout(set = 1, scalar) buffer WorldCacheActiveCellsBlock { uint at[]; } world_cache_active_cells;
// The irradiance that an active cell received in this frame, and its life before queries of other cells raised it.
struct WorldCacheSample {
    vec3 irradiance;
    uint life;     // without the flag SEES_WALL
};
const uint SEES_WALL = 0x80000000u;  // the cell's point of this frame doesn't see the cell's first point
layout(set = 1, scalar) buffer WorldCacheSamplesBlock { WorldCacheSample at[]; } world_cache_samples;
// The round in which a frame updates cells: passes/world_cache/begin_round.comp.
layout(set = 1, scalar) buffer WorldCacheDispatchBlock {
    IndirectDispatch size;
    uint rounds_left;  // rounds of the fill that aren't done yet, with the one that runs; 0 in the last round
    uint first_cell;   // where the cells of this round begin in the list of active cells
    uint old_cells;    // active cells that earlier frames asked for; those that the fill adds come after them
    uint misses;       // requests for cells without a value
} world_cache_dispatch;

// The paths of the cells that a frame updates, for passes/world_cache/trace.comp, which only traces. `thread`: the one
// for which find_cell_to_update returns the cell; NO_INDEX once the path has ended.
struct WorldCachePath {
    PathState state;
    PathRays rays;
    PathHit hit;
    uint thread;
    uint unused[3];  // so that quads begin at multiples of their size
};
layout(set = 1, scalar) buffer WorldCachePathsBlock { WorldCachePath at[]; } world_cache_paths;

// Counters of this frame.
layout(set = 1, scalar) buffer WorldCacheCountersBlock {
    uint active_cells;
    uint updates;
    uint insert_failures;  // queries that found no free entry
} world_cache_counters;

#endif
