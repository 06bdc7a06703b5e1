// The world cache's hash map: keys, finding and inserting cells, and the surface point that represents a cell.
#ifndef PASSES_WORLD_CACHE_MAP_GLSL
#define PASSES_WORLD_CACHE_MAP_GLSL

#include "common/packing.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/world_cache/bindings.glsl"
#include "scene/bindings.glsl"

const uint EMPTY_CELL = 0u;  // no key's checksum

// ---- keys -------------------------------------------------------------------------------------------

// The distance of a position from the camera; of many, from a ball around all of them, so that views share cells. No
// camera is nearer.
float distance_from_cameras(vec3 world_position) {
#ifdef MANY_VIEWS
    return max(distance(world_position, views.ball_center) - views.ball_radius, 0.0);
#else
    return distance(world_position, camera.world_from_view[3]);
#endif
}

// The size of the cells at a position. It doubles with distance from the camera; a random number decides between the
// two nearest sizes, so that the levels blend into each other.
float get_cell_size(vec3 world_position, inout uint rng) {
    float level = log2(1.0 + distance_from_cameras(world_position) / world_cache_settings.lod_distance);
    float part = fract(level);
    int doublings = int(level) + (rand_f(rng) < pow(part, world_cache_settings.lod_sharpness) ? 1 : 0);
    return world_cache_settings.cell_size * power_of_two(doublings);
}

struct WorldCacheKey {
    vec4 bounds;    // minimum corner and size of the cell
    uint first;     // the entry at which the search begins
    uint checksum;
};

// Slightly larger than rounding errors, so that a surface on a plane of the grid lies wholly on one side of it.
const float GRID_MARGIN = 0.0001;

WorldCacheKey make_world_cache_key(vec3 world_position, vec3 world_normal, float cell_size) {
    vec3 position = clamp(floor(world_position / cell_size + GRID_MARGIN), -1e9, 1e9);
    ivec3 normal = ivec3(floor(world_normal + GRID_MARGIN));
    uint kind = pcg(floatBitsToUint(cell_size)) + uint(normal.x + 3 * normal.y + 9 * normal.z);
#ifdef MANY_VIEWS
    kind += world_index * WORLD_SALT;
#endif
    uvec4 hash = pcg4d(uvec4(ivec3(position), kind));
    return WorldCacheKey(vec4(position * cell_size, cell_size), hash.x, max(hash.y, EMPTY_CELL + 1u));
}

// ---- the map ----------------------------------------------------------------------------------------

// Each world of a batch has a part of the map, so that threads which run together trace rays in one world.
uint world_cache_entry(WorldCacheKey key, uint search_step) {
    uint entries = uint(world_cache_checksums.at.length());
#ifdef MANY_VIEWS
    entries /= views.cache_partitions;
    return world_index * entries + ((key.first + search_step) & entries - 1u);
#else
    return (key.first + search_step) & entries - 1u;
#endif
}

// The index of a key's cell, or NO_INDEX when the map doesn't have it. `empty_step` is the first step of the search
// that finds an empty entry. Differs from Solari: the search continues after empty entries, since their cells may
// have died after the key was inserted.
uint find_world_cache_cell(WorldCacheKey key, out uint empty_step) {
    empty_step = world_cache_settings.search_steps;
    for (uint i = 0u; i < world_cache_settings.search_steps; i++) {
        uint cell = world_cache_entry(key, i);
        uint checksum = world_cache_checksums.at[cell];
        if (checksum == key.checksum) { return cell; }
        if (checksum == EMPTY_CELL) { empty_step = min(empty_step, i); }
    }
    return NO_INDEX;
}

// The index of a key's cell, which is inserted if it is new, or NO_INDEX when all entries of its search are taken. No
// cell dies in the passes that insert cells, so that no key gets two entries.
uint insert_world_cache_cell(WorldCacheKey key, out bool is_new) {
    uint search_step;
    is_new = false;
    uint cell = find_world_cache_cell(key, search_step);
    for (; cell == NO_INDEX && search_step < world_cache_settings.search_steps; search_step++) {
        uint entry = world_cache_entry(key, search_step);
        uint existing = atomicCompSwap(world_cache_checksums.at[entry], EMPTY_CELL, key.checksum);
        if (existing == EMPTY_CELL) {
            is_new = true;
            world_cache_bounds.at[entry] = key.bounds;
#ifdef MANY_VIEWS
            world_cache_worlds.at[entry] = world_index;
#endif
        }
        if (existing == EMPTY_CELL || existing == key.checksum) { cell = entry; }
    }
    return cell;
}

struct WorldCacheResult {
    uint cell;   // NO_INDEX when the map has no free entry
    bool found;  // whether the cell has a value
    vec3 irradiance;
};

const WorldCacheResult NO_CELL = WorldCacheResult(NO_INDEX, false, vec3(0.0));

// The irradiance of a cell of the map, which is kept alive for `lifetime` frames.
WorldCacheResult read_world_cache_cell(uint cell, uint lifetime) {
    atomicMax(world_cache_life.at[cell], lifetime);
    vec4 irradiance = world_cache_irradiance.at[cell];
    bool usable = irradiance.w > 0.0 && world_cache_first_points.at[cell] != DIVIDED_CELL;
    return WorldCacheResult(cell, usable, irradiance.rgb);
}

// ---- the point that represents a cell ---------------------------------------------------------------
//
// Differs from Solari, where it is the point of the first query for the cell's whole life: here each frame picks the
// point of a random query, whose choice doesn't depend on the order of queries, so that the mean irradiance is that
// of the whole cell.

// Among queries of equal priority the largest data wins. Data is shuffled by an odd factor, so that no side of the
// cell is preferred, and unshuffled by the factor's inverse modulo 2^24.
uint shuffle_24(uint payload) { return payload * 0x3779B1u & 0xFFFFFFu; }
uint unshuffle_24(uint payload) { return payload * 0x8B2F51u & 0xFFFFFFu; }

// The bounds of all points that may query a cell, which the jitter moves outside of it.
vec4 grow_bounds(vec4 bounds) {
    float jitter = world_cache_settings.jitter;
    return vec4(bounds.xyz - jitter * bounds.w, (1.0 + 2.0 * jitter) * bounds.w);
}

void vote_for_point(uint cell, vec4 bounds, vec3 world_position, vec3 world_normal, inout uint rng) {
    uint priority = 1u + rand_range_u(255u, rng);
    vec4 grown = grow_bounds(bounds);
    vec3 within = (world_position - grown.xyz) / grown.w;
    uint position = pack_unorm(within.x, 8u) | pack_unorm(within.y, 8u) << 8u | pack_unorm(within.z, 8u) << 16u;
    uint normal = pack_octahedral_24(world_normal);
    atomicMax(world_cache_votes.at[cell].position, priority << 24u | shuffle_24(position));
    atomicMax(world_cache_votes.at[cell].normal, priority << 24u | shuffle_24(normal));
}

// Makes the point that a query has voted for the cell's point. Returns false where no query has asked the cell.
bool take_voted_point(uint cell) {
    WorldCachePoint votes = world_cache_votes.at[cell];
    if (votes.position == 0u) { return false; }
    world_cache_points.at[cell] = votes;
    if (world_cache_first_points.at[cell].position == 0u) { world_cache_first_points.at[cell] = votes; }
    world_cache_votes.at[cell] = WorldCachePoint(0u, 0u);
    return true;
}

uint without_priority(uint vote) { return vote & 0xFFFFFFu; }

// Whether the cell's irradiance is sampled in this frame: only if the previous frame asked for it. Differs from Solari,
// which samples all cells (world_cache_updates=all).
bool is_to_update(uint cell) {
    uint position = world_cache_points.at[cell].position;
    bool asked = position != without_priority(position);
    return world_cache_checksums.at[cell] != EMPTY_CELL && world_cache_first_points.at[cell] != DIVIDED_CELL
        && (asked || world_cache_settings.updates == WORLD_CACHE_UPDATES_ALL);
}

struct WorldCacheSurface {
    vec3 world_position;
    vec3 geometric_world_normal;
    float ray_offset;  // includes the error of the position's few bits
};

WorldCacheSurface unpack_point(uint cell, WorldCachePoint point) {
    vec4 grown = grow_bounds(world_cache_bounds.at[cell]);
    uint code = unshuffle_24(point.position);
    vec3 within = vec3(unpack_unorm(code, 8u), unpack_unorm(code >> 8u, 8u), unpack_unorm(code >> 16u, 8u));

    WorldCacheSurface surface;
    surface.world_position = grown.xyz + within * grown.w;
    surface.geometric_world_normal = unpack_octahedral_24(unshuffle_24(point.normal));
    vec3 max_error = vec3(grown.w * (0.5 / 255.0)) + 16.0 * ROUNDING_UNIT * (abs(grown.xyz) + grown.w);
    surface.ray_offset = dot(max_error, abs(surface.geometric_world_normal));
    return surface;
}

WorldCacheSurface load_world_cache_surface(uint cell) { return unpack_point(cell, world_cache_points.at[cell]); }

#endif
