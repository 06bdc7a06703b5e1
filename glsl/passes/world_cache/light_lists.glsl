// Lists of the lights that cells see, so that surfaces choose lights with knowledge of walls. A cell of a list is a
// cell of the world cache's map with a larger size, whose irradiance isn't sampled. Surfaces vote for the lights to
// which they trace shadow rays; the next frame's update_light_lists.comp counts the votes, in an order that doesn't
// depend on that of threads.
//
// A surface takes part of its light samples from the list of its cell, in proportion to what the tree of lights expects
// of each light there times the light's visibility so far, and the others from the tree. Each light has the density of
// this mixture, so that the mean is right whatever a list holds. Among several samples, those of lights
// that are seldom visible are chosen less often, as in AMD's neural visibility cache (Bokšanský and Meister, "Neural
// Visibility Cache for Real-Time Light Sampling", 2025).
#ifndef PASSES_WORLD_CACHE_LIGHT_LISTS_GLSL
#define PASSES_WORLD_CACHE_LIGHT_LISTS_GLSL

#include "passes/world_cache/map.glsl"
#include "scene/lights/tree.glsl"

layout(constant_id = light_lists_id) const bool light_lists = false;

const uint LIST_KIND = 0x117E57C5u;    // in keys: lists are no cells of irradiance
const float LIST_CELLS = 4.0;          // size of a list's cell in cells of irradiance, at least
const float LIST_PIXELS = 3.0;         // and in pixels
const float TREE_SHARE = 0.3;          // of light samples, at a surface that has a list
const float MIN_VISIBILITY = 0.1;      // so that a light that appears isn't far too bright in the frame that finds it

// An entry: one over the leaf's index, its occlusion so far, and a count by which seldom chosen lights are replaced.
const uint LEAF_BITS = 20u, OCCLUSION_BITS = 6u, COUNT_BITS = 6u;
const uint MAX_LEAF = (1u << LEAF_BITS) - 1u, FULL_OCCLUSION = (1u << OCCLUSION_BITS) - 1u;
const uint MAX_COUNT = (1u << COUNT_BITS) - 1u;

uint entry_leaf(uint entry) { return (entry >> (OCCLUSION_BITS + COUNT_BITS)) - 1u; }  // NO_INDEX: an empty entry
uint entry_occlusion(uint entry) { return entry >> COUNT_BITS & FULL_OCCLUSION; }
uint entry_count(uint entry) { return entry & MAX_COUNT; }
uint pack_entry(uint leaf, uint occlusion, uint count) {
    return ((leaf + 1u) << OCCLUSION_BITS | occlusion) << COUNT_BITS | count;
}

// ---- cells -------------------------------------------------------------------------------------------

// The same for equal receivers, so that a ray that hits a light finds the density of its light samples.
WorldCacheKey light_list_key(Receiver receiver) {
    float distance = distance(receiver.position, camera.world_from_view[3]);
    float pixel = 2.0 * camera.tan_half_fov.y / float(camera.size.y) * (camera.parallel_range > 0.0 ? 1.0 : distance);
    float wanted = max(LIST_CELLS * (1.0 + distance / world_cache_settings.lod_distance),
        LIST_PIXELS * pixel / world_cache_settings.cell_size);
    float size = world_cache_settings.cell_size * power_of_two(int(ceil(log2(wanted) - 0.5)));
    vec3 position = clamp(floor(receiver.position / size + GRID_MARGIN), -1e9, 1e9);
    vec3 along = abs(receiver.normal);
    uint axis = along.x > max(along.y, along.z) ? 0u : along.y > along.z ? 1u : 2u;
    uint side = 2u * axis + uint(receiver.normal[axis] > 0.0);
    uvec4 hash = pcg4d(uvec4(ivec3(position), pcg(floatBitsToUint(size) ^ LIST_KIND) + side));
    return WorldCacheKey(vec4(position * size, size), hash.x, max(hash.y, EMPTY_CELL + 1u));
}

// What a receiver knows of lights.
struct LightList {
    uint cell;  // NO_INDEX: it has no list
    uint count;
    float share;  // of light samples that are taken from the list
    float sum;    // of the weights
    float weights[LIGHT_LIST_SIZE];
};

// Where a light is visible with probability v, choosing it in proportion to sqrt(v) gives the least variance.
float visibility_factor(float occlusion) { return sqrt(max(1.0 - occlusion, MIN_VISIBILITY)); }
float entry_factor(uint entry) { return visibility_factor(float(entry_occlusion(entry)) / float(FULL_OCCLUSION)); }

// `inserts`: makes a list for the receiver's cell if it has none, and keeps it alive.
LightList find_light_list(Receiver receiver, bool inserts) {
    LightList list;
    list.cell = NO_INDEX;
    list.count = 0u;
    list.share = list.sum = 0.0;
    if (!light_lists || receiver.normal == vec3(0.0)) { return list; }
    WorldCacheKey key = light_list_key(receiver);
    uint empty_step;
    list.cell = inserts ? insert_world_cache_cell(key) : find_world_cache_cell(key, empty_step);
    if (list.cell == NO_INDEX) { return list; }
    if (inserts) { atomicMax(world_cache_life.at[list.cell], world_cache_settings.lifetime); }
    for (; list.count < LIGHT_LIST_SIZE; list.count++) {
        uint entry = world_cache_light_lists.at[list.cell].entries[list.count];
        if (entry == 0u) { break; }
        LightNode node = light_tree.at[light_leaves.at[entry_leaf(entry)].node];
        float weight = max(importance(node, receiver) * entry_factor(entry), MIN_IMPORTANCE);
        list.weights[list.count] = weight;
        list.sum += weight;
    }
    if (list.count > 0u) { list.share = clamp(world_cache_light_lists.at[list.cell].coverage, 0.1, 1.0 - TREE_SHARE); }
    return list;
}

// ---- choice ------------------------------------------------------------------------------------------

// The entry of a leaf, or list.count.
uint find_entry(LightList list, uint leaf) {
    uint i = 0u;
    while (i < list.count && entry_leaf(world_cache_light_lists.at[list.cell].entries[i]) != leaf) { i++; }
    return i;
}

// Of the leaf of an entry, or of another leaf. `by_tree`: the probability with which the tree chooses it.
float mixed_probability(LightList list, uint i, float by_tree) {
    float by_list = i < list.count ? list.weights[i] / list.sum : 0.0;
    return list.share * by_list + (1.0 - list.share) * by_tree;
}

struct ListedLeaf {
    ChosenLeaf chosen;
    float factor;       // by which the surface's choice among several samples weighs this one
};

float unlisted_factor(LightList list) {
    return list.count > 0u ? visibility_factor(world_cache_light_lists.at[list.cell].unlisted_occlusion) : 1.0;
}

// `turn`, uniform in [0, 1), decides between list and tree.
ListedLeaf choose_leaf(Receiver receiver, LightList list, float turn, inout uint rng) {
    uint row = choose_leaf(rng);
    LightLeaf leaf = light_leaves.at[row];
    if (leaf.node == NO_INDEX) { return ListedLeaf(ChosenLeaf(row, leaf.by_power.probability), 1.0); }
    ListedLeaf listed;
    if (turn < list.share) {
        float left = rand_f(rng) * list.sum;
        uint i = 0u;
        while (i + 1u < list.count && left >= list.weights[i]) { left -= list.weights[i++]; }
        uint entry = world_cache_light_lists.at[list.cell].entries[i];
        row = entry_leaf(entry);
        float by_tree = node_probability(light_leaves.at[row].node, receiver);
        listed = ListedLeaf(ChosenLeaf(row, mixed_probability(list, i, by_tree)), entry_factor(entry));
    } else {
        listed.chosen = descend_light_tree(receiver, rng);
        uint i = find_entry(list, listed.chosen.leaf);
        listed.chosen.probability = mixed_probability(list, i, listed.chosen.probability);
        bool is_listed = i < list.count;
        listed.factor = is_listed ? entry_factor(world_cache_light_lists.at[list.cell].entries[i]) : unlisted_factor(list);
    }
    listed.chosen.probability *= scene_info.finite_probability;
    return listed;
}

// The probability with which a receiver takes this leaf for a light sample.
float listed_leaf_probability(uint row, Receiver receiver) {
    LightLeaf leaf = light_leaves.at[row];
    LightList list = find_light_list(receiver, false);
    if (list.count == 0u || leaf.node == NO_INDEX) { return leaf_choice_probability(row, receiver); }
    float by_tree = node_probability(leaf.node, receiver);
    return scene_info.finite_probability * mixed_probability(list, find_entry(list, row), by_tree);
}
#define LEAF_PROBABILITY listed_leaf_probability

// ---- votes -------------------------------------------------------------------------------------------

const uint SEEN = 1u << LEAF_BITS;

void vote_for_leaf(uint cell, uint leaf, bool seen, inout uint rng) {
    if (cell == NO_INDEX || leaf >= MAX_LEAF || light_leaves.at[leaf].node == NO_INDEX) { return; }
    uint priority = 1u + rand_range_u((1u << (31u - LEAF_BITS)) - 1u, rng);
    uint vote = priority << (LEAF_BITS + 1u) | (seen ? SEEN : 0u) | (leaf + 1u);
    atomicMax(world_cache_light_lists.at[cell].votes[rand_range_u(LIGHT_VOTES, rng)], vote);
    world_cache_light_lists.at[cell].used = 1u;
}

#endif
