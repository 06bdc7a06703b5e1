// World cache: counts the votes of the previous frame for the lights that each cell sees, after decay.comp. Lists hold
// the lights that get most votes: Misra and Gries, "Finding Repeated Elements" (1982).
#version 460
#include "generated/passes/world_cache.glsl"
#include "passes/world_cache/light_lists.glsl"

layout(local_size_x = GROUP_SIZE) in;

const uint VOTE_COUNT = 4u;              // what a vote adds to a light's count
const uint FIRST_OCCLUSION = 16u;        // of a light that is listed, which was seen once
const uint MOVED_OCCLUSION = 32u;        // at most, of a light that has moved
const float SHARE_SMOOTHING = 0.0625;

// A leaf of the previous frame in this frame, or NO_INDEX.
uint translated(uint leaf) { return leaf < MAX_LEAF ? leaf_translation.at[leaf] : NO_INDEX; }

bool has_moved(uint leaf) {
    return this_frame.lighting_change > 0.0 && previous_light.at[light_leaves.at[leaf].light] == NO_INDEX;
}

void clear_list(uint cell) {
    for (uint i = 0u; i < LIGHT_LIST_SIZE; i++) { world_cache_light_lists.at[cell].entries[i] = 0u; }
    for (uint i = 0u; i < LIGHT_VOTES; i++) { world_cache_light_lists.at[cell].votes[i] = 0u; }
    world_cache_light_lists.at[cell].unlisted_occlusion = world_cache_light_lists.at[cell].coverage = 0.0;
    world_cache_light_lists.at[cell].used = 0u;
}

// Removes entries of lights that are gone. Returns the number of entries.
uint translate_entries(uint cell) {
    uint count = 0u;
    for (uint i = 0u; i < LIGHT_LIST_SIZE; i++) {
        uint entry = world_cache_light_lists.at[cell].entries[i];
        if (entry == 0u) { break; }
        uint leaf = translated(entry_leaf(entry)), occlusion = entry_occlusion(entry);
        if (leaf >= MAX_LEAF) { continue; }
        if (has_moved(leaf)) { occlusion = min(occlusion, MOVED_OCCLUSION); }
        world_cache_light_lists.at[cell].entries[count++] = pack_entry(leaf, occlusion, entry_count(entry));
    }
    for (uint i = count; i < LIGHT_LIST_SIZE; i++) { world_cache_light_lists.at[cell].entries[i] = 0u; }
    return count;
}

// Smooths a share to which a vote adds 0 or 1.
float smoothed(float share, bool one) { return mix(share, one ? 1.0 : 0.0, SHARE_SMOOTHING); }

void cover(uint cell, bool listed) {
    world_cache_light_lists.at[cell].coverage = smoothed(world_cache_light_lists.at[cell].coverage, listed);
}

void count_vote(uint cell, uint leaf, bool seen, inout uint count) {
    uint least = 0u, least_count = MAX_COUNT + 1u;
    for (uint i = 0u; i < count; i++) {
        uint entry = world_cache_light_lists.at[cell].entries[i];
        uint occlusion = entry_occlusion(entry), votes = entry_count(entry);
        if (entry_leaf(entry) == leaf) {
            occlusion = seen ? occlusion - (occlusion + 3u) / 4u : occlusion + (FULL_OCCLUSION - occlusion + 3u) / 4u;
            votes = min(votes + VOTE_COUNT, MAX_COUNT);
            world_cache_light_lists.at[cell].entries[i] = pack_entry(leaf, occlusion, votes);
            if (seen) { cover(cell, true); }
            return;
        }
        if (votes < least_count) {
            least = i;
            least_count = votes;
        }
    }
    float occlusion = world_cache_light_lists.at[cell].unlisted_occlusion;
    world_cache_light_lists.at[cell].unlisted_occlusion = smoothed(occlusion, !seen);
    if (!seen) { return; }
    cover(cell, false);
    uint entry = pack_entry(leaf, FIRST_OCCLUSION, VOTE_COUNT);
    if (count < LIGHT_LIST_SIZE) {
        world_cache_light_lists.at[cell].entries[count++] = entry;
    } else if (least_count == 0u) {
        world_cache_light_lists.at[cell].entries[least] = entry;
    } else {
        for (uint i = 0u; i < LIGHT_LIST_SIZE; i++) {
            uint other = world_cache_light_lists.at[cell].entries[i];
            world_cache_light_lists.at[cell].entries[i] = other - min(entry_count(other), 1u);
        }
    }
}

void main() {
    uint block = thread_index(gl_GlobalInvocationID.xy);
    for (uint cell = block * BLOCK_SIZE; cell < (block + 1u) * BLOCK_SIZE; cell++) {
        if (world_cache_checksums.at[cell] == EMPTY_CELL) {
            if (world_cache_light_lists.at[cell].used != 0u) { clear_list(cell); }
            continue;
        }
        if (world_cache_light_lists.at[cell].used == 0u) { continue; }
        uint count = translate_entries(cell);
        for (uint i = 0u; i < LIGHT_VOTES; i++) {
            uint vote = world_cache_light_lists.at[cell].votes[i];
            if (vote == 0u) { continue; }
            world_cache_light_lists.at[cell].votes[i] = 0u;
            uint leaf = translated((vote & MAX_LEAF) - 1u);
            if (leaf < MAX_LEAF) { count_vote(cell, leaf, (vote & SEEN) != 0u, count); }
        }
    }
}
