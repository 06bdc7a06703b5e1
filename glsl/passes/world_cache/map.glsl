// The world cache's hash map: keys, searching and inserting cells, and the point that stands for a cell.
#ifndef PASSES_WORLD_CACHE_MAP_GLSL
#define PASSES_WORLD_CACHE_MAP_GLSL

#include "common/packing.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/world_cache/bindings.glsl"
#include "scene/bindings.glsl"

const uint EMPTY_CELL = 0u;  // no key's checksum

// ---- keys -------------------------------------------------------------------------------------------

// The size of the cells at a position. It doubles with distance from the camera; a random number decides between the two
// nearest sizes, so that the levels blend into each other.
float get_cell_size(vec3 world_position, inout uint rng) {
    float level = log2(1.0 + distance(world_position, camera.world_from_view[3]) / world_cache_settings.lod_distance);
    float part = fract(level);
    int doublings = int(level) + (rand_f(rng) < pow(part, world_cache_settings.lod_sharpness) ? 1 : 0);
    return world_cache_settings.cell_size * power_of_two(doublings);
}

struct WorldCacheKey {
    vec4 bounds;    // least corner and size of the cell: the same for all who ask for it
    uint first;     // where the search begins
    uint checksum;
};

// A little more than rounding errors, so that surfaces along the grid fall to one side of it.
const float GRID_MARGIN = 0.0001;

WorldCacheKey make_world_cache_key(vec3 world_position, vec3 world_normal, float cell_size) {
    vec3 position = clamp(floor(world_position / cell_size + GRID_MARGIN), -1e9, 1e9);
    ivec3 normal = ivec3(floor(world_normal + GRID_MARGIN));
    uint kind = pcg(floatBitsToUint(cell_size)) + uint(normal.x + 3 * normal.y + 9 * normal.z);
    uvec4 hash = pcg4d(uvec4(ivec3(position), kind));
    return WorldCacheKey(vec4(position * cell_size, cell_size), hash.x, max(hash.y, EMPTY_CELL + 1u));
}

// A cell that a wall goes through has parts, one for each landmark: the first landmark that is visible from a point decides
// which part the point belongs to. Landmarks 0 and 1 are centers of cells and stand for whole cells; the others lie around
// the center of the point's own cell.
const uint LANDMARKS = 6u;

// The key of a part of a cell, which has the same bounds.
WorldCacheKey part_of_cell(WorldCacheKey key, uint part) {
    return WorldCacheKey(key.bounds, pcg(key.first + part), max(pcg(key.checksum + part), EMPTY_CELL + 1u));
}

// ---- the map ----------------------------------------------------------------------------------------

uint world_cache_place(WorldCacheKey key, uint search_step) {
    return (key.first + search_step) & uint(world_cache_checksums.at.length() - 1);
}

// NO_INDEX where there is none. `empty_step`: the first step of the search that comes to an empty cell, if any does. Differs
// from Solari in that the search goes on past empty cells: what filled them when a key was inserted may have died since.
uint find_world_cache_cell(WorldCacheKey key, out uint empty_step) {
    empty_step = world_cache_settings.search_steps;
    for (uint i = 0u; i < world_cache_settings.search_steps; i++) {
        uint cell = world_cache_place(key, i);
        uint checksum = world_cache_checksums.at[cell];
        if (checksum == key.checksum) { return cell; }
        if (checksum == EMPTY_CELL) { empty_step = min(empty_step, i); }
    }
    return NO_INDEX;
}

// The cell of a key, new or not; NO_INDEX where all places are taken. Cells never die while others are inserted, so
// that a key can't come to be in two places.
uint insert_world_cache_cell(WorldCacheKey key) {
    uint search_step;
    uint cell = find_world_cache_cell(key, search_step);
    for (; cell == NO_INDEX && search_step < world_cache_settings.search_steps; search_step++) {
        uint place = world_cache_place(key, search_step);
        uint existing = atomicCompSwap(world_cache_checksums.at[place], EMPTY_CELL, key.checksum);
        if (existing == EMPTY_CELL) { world_cache_bounds.at[place] = key.bounds; }
        if (existing == EMPTY_CELL || existing == key.checksum) { cell = place; }
    }
    return cell;
}

// ---- the point that stands for a cell ---------------------------------------------------------------
// Differs from Solari, where it is the first asker's, whoever that is, for the cell's whole life: each frame one asker is
// chosen by chance, but the same one in whatever order they come, so that the mean is the cell's and not one point's.

// Among askers of one priority the largest payload wins: shuffled by an odd factor, and back by its inverse modulo 2^24.
uint shuffle_24(uint payload) { return payload * 0x3779B1u & 0xFFFFFFu; }
uint unshuffle_24(uint payload) { return payload * 0x8B2F51u & 0xFFFFFFu; }

// Askers may be outside their cell by the jitter.
vec4 grow_bounds(vec4 bounds) {
    return vec4(bounds.xyz - world_cache_settings.jitter * bounds.w, (1.0 + 2.0 * world_cache_settings.jitter) * bounds.w);
}

void vote_for_point(uint cell, vec4 bounds, vec3 world_position, vec3 world_normal, inout uint rng) {
    uint priority = 1u + rand_range_u(255u, rng);
    vec4 grown = grow_bounds(bounds);
    vec3 within = (world_position - grown.xyz) / grown.w;
    uint position = pack_unorm(within.x, 8u) | pack_unorm(within.y, 8u) << 8u | pack_unorm(within.z, 8u) << 16u;
    uint normal = pack_octahedral_24(world_normal, 0u);
    atomicMax(world_cache_votes.at[cell].position, priority << 24u | shuffle_24(position));
    atomicMax(world_cache_votes.at[cell].normal, priority << 24u | shuffle_24(normal));
}

struct WorldCacheSurface {
    vec3 world_position;
    vec3 geometric_world_normal;
    float ray_offset;  // covers that the position is stored in few bits
};

WorldCacheSurface load_world_cache_surface(uint cell) {
    WorldCachePoint point = world_cache_points.at[cell];
    vec4 grown = grow_bounds(world_cache_bounds.at[cell]);
    uint code = unshuffle_24(point.position);
    vec3 within = vec3(unpack_unorm(code, 8u), unpack_unorm(code >> 8u, 8u), unpack_unorm(code >> 16u, 8u));

    WorldCacheSurface surface;
    surface.world_position = grown.xyz + within * grown.w;
    surface.geometric_world_normal = unpack_octahedral_24(unshuffle_24(point.normal));
    vec3 most = vec3(grown.w * (0.5 / 255.0)) + 16.0 * ROUNDING_UNIT * (abs(grown.xyz) + grown.w);
    surface.ray_offset = dot(most, abs(surface.geometric_world_normal));
    return surface;
}

#endif
