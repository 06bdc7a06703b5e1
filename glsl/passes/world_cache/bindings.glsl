// What the world cache keeps: a hash map of fixed size with an element a cell in each buffer.
#ifndef PASSES_WORLD_CACHE_BINDINGS_GLSL
#define PASSES_WORLD_CACHE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// Where a cell was asked, 8 bits of priority above 24 bits of payload each, so that atomicMax picks one asker's: position
// within the cell and its surroundings, and octahedral normal.
struct WorldCachePoint {
    uint position;
    uint normal;
};

layout(set = 1, binding = 40, scalar) buffer WorldCacheChecksumsBlock { uint at[]; } world_cache_checksums;  // 0: empty
layout(set = 1, binding = 41, scalar) buffer WorldCacheLifeBlock { uint at[]; } world_cache_life;  // frames left
layout(set = 1, binding = 42, scalar) buffer WorldCacheIrradianceBlock { vec4 at[]; } world_cache_irradiance;  // w: samples in it
layout(set = 1, binding = 43, scalar) buffer WorldCacheBoundsBlock { vec4 at[]; } world_cache_bounds;  // least corner, size
layout(set = 1, binding = 44, scalar) buffer WorldCacheVotesBlock { WorldCachePoint at[]; } world_cache_votes;
layout(set = 1, binding = 45, scalar) buffer WorldCachePointsBlock { WorldCachePoint at[]; } world_cache_points;
layout(set = 1, binding = 46, scalar) buffer WorldCacheDeltasBlock { float at[]; } world_cache_luminance_deltas;

// Of blocks of the map: how many cells are active, then in how many before the block.
layout(set = 1, binding = 47, scalar) buffer WorldCacheBlocksBlock { uint at[]; } world_cache_blocks;
layout(set = 1, binding = 48, scalar) buffer WorldCacheActiveCellsBlock { uint at[]; } world_cache_active_cells;
// What an active cell got in this frame, and its life before others raised it.
struct WorldCacheSample {
    vec3 irradiance;
    uint life;
};
layout(set = 1, binding = 49, scalar) buffer WorldCacheSamplesBlock { WorldCacheSample at[]; } world_cache_samples;
layout(set = 1, binding = 50, scalar) buffer WorldCacheDispatchBlock { uvec3 group_count; } world_cache_dispatch;

// Of this frame.
layout(set = 1, binding = 51, scalar) buffer WorldCacheCountersBlock {
    uint active_cells;
    uint updates;
    uint insert_failures;  // queries that found no place
} world_cache_counters;

#endif
