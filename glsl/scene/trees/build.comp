// Builds trees over triangles or instances: parallel locally-ordered clustering (Meister and Bittner, "Parallel
// Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", 2018). Primitives come in spatial order, so
// that near ones are close to each other in the list of clusters. In each round every cluster looks for its nearest one
// within SEARCH_RADIUS places, and clusters that are each other's nearest become one.
//
// The primitives are halved again and again, as solari_vk/bound/spatial_order.py does, into chunks that one workgroup
// each clusters. While there are several chunks, some clusters of each are left, and the next stage, a dispatch of its
// own, puts those of neighboring chunks together. The last chunk becomes the root; then all workgroups write nodes and
// leaves. A tree of one chunk is built in one dispatch.
//
// The host gives all memory by address and puts barriers around each dispatch.
#version 460
#include "scene/trees/primitives.glsl"

layout(local_size_x = 256) in;

const int SEARCH_RADIUS = 12;
const uint MAX_ROUNDS = 48u;          // in which the nearest are looked for
const uint UNHITTABLE = 0xFFFFFFFFu;  // Cluster.parent of primitives that no ray can hit
const uint IS_LEAF = 1u << 31;        // in Cluster.size: all of the subtree becomes one leaf
const uint IMPROVING_STAGES = 1u << 30;
const uint SORTING_STAGES = 1u << 31;
const uint WRITING_STAGE = 0xFFFFFFFFu;

layout(push_constant, scalar) uniform Work {
    TreeBuilds builds;
    Parts parts;  // builds and chunks
    uint stage;
    uint stage_halvings;  // which each stage undoes
    uint left_halvings;   // of a chunk up to 2^left_halvings clusters are left
} work;

const uint SUM_GROUP = 16u;  // threads whose values one thread adds
const uint SUM_GROUPS = THREADS / SUM_GROUP;
shared uint sums[THREADS];
shared uint group_sums[SUM_GROUPS];

uint thread;
// The primitives of this workgroup's chunk: [chunk_begin, chunk_end). Its lists have the same place among all.
uint chunk_begin;
uint chunk_end;
uint attempt;  // how often its triangles have been clustered before

void wait_for_all() {
    memoryBarrierBuffer();
    memoryBarrierShared();
    barrier();
}

// The sum of the values of all threads before this one, and of all, to make a list without gaps. In two steps with few
// barriers, which are expensive on software devices.
uint sum_before(uint value, out uint total) {
    sums[thread] = value;
    wait_for_all();
    if (thread < SUM_GROUPS) {
        uint sum = 0u;
        for (uint i = thread * SUM_GROUP; i < (thread + 1u) * SUM_GROUP; i++) {
            uint next = sums[i];
            sums[i] = sum;
            sum += next;
        }
        group_sums[thread] = sum;
    }
    wait_for_all();
    uint before = sums[thread];
    total = 0u;
    for (uint group = 0u; group < SUM_GROUPS; group++) {
        if (group == thread / SUM_GROUP) { before += total; }
        total += group_sums[group];
    }
    return before;
}

// The part of a list that a thread has: [begin, end).
void own_part(uint count, out uint begin, out uint end) {
    uint share = (count + THREADS - 1u) / THREADS;
    begin = min(thread * share, count);
    end = min(begin + share, count);
}

// After how many halvings the chunks of a stage begin.
uint halvings_of(uint stage) { return build.halvings - min(build.halvings, work.stage_halvings * stage); }

// The ends of one of 2^halvings chunks. Of an odd number the first half is the larger one.
void find_chunk(uint halvings, uint number, out uint begin, out uint end) {
    uint size = build.count;
    begin = 0u;
    for (uint bit = halvings; bit-- > 0u;) {
        uint second = size / 2u;
        bool is_second = (number >> bit & 1u) != 0u;
        if (is_second) { begin += size - second; }
        size = is_second ? second : size - second;
    }
    end = begin + size;
}

// How often a number must be halved, rounded up, to become 1.
uint halvings_to_one(uint count) { return count > 1u ? uint(findMSB(count - 1u)) + 1u : 0u; }

#include "scene/trees/clusters.glsl"
#include "scene/trees/sort.glsl"

// ---- from clusters to nodes -------------------------------------------------------------------------

// Where the primitives and the leaves of a subtree begin in the order of the tree.
struct Place {
    uint primitive;
    uint leaf;
    bool within_leaf;  // of a part of a leaf, whose `leaf` means nothing
};

Place behind(Place place, Cluster cluster) {
    uint primitive = place.primitive + (cluster.size & ~IS_LEAF);
    return Place(primitive, place.leaf + leaves_of(cluster), place.within_leaf);
}

Place place_of(uint cluster) {
    Place place = Place(0u, 0u, false);
    uint parent = build.clusters.at[cluster].parent;
    while (parent >= build.count) {
        Cluster above = build.clusters.at[parent];
        if (above.second == cluster) { place = behind(place, build.clusters.at[above.first]); }
        place.within_leaf = place.within_leaf || (above.size & IS_LEAF) != 0u;
        cluster = parent;
        parent = above.parent;
    }
    return place;
}

// A child of a node.
uint reference_of(Cluster child, Place place) {
    uint size = child.size & ~IS_LEAF;
    if ((child.size & IS_LEAF) != 0u) { return LEAF | (size - 1u) << LEAF_COUNT_SHIFT | place.primitive; }
    // Each node lies between two leaves, where its second child begins, and no two nodes lie between the same.
    return place.leaf + leaves_of(build.clusters.at[child.first]);
}

void write_leaf(uint number) {
    uint place = place_of(number).primitive;
    if (build.is_of_instances != 0u) { write_instance(place, number); } else { write_triangle(place, number); }
}

void write_node(uint node) {
    Cluster own = build.clusters.at[node];
    Place place = place_of(node);
    if (place.within_leaf || (own.size & IS_LEAF) != 0u) { return; }
    Cluster first = build.clusters.at[own.first], second = build.clusters.at[own.second];
    Place middle = behind(place, first);
    uint parent = 0u;
    if (own.parent >= build.count) {
        parent = build.clusters.at[own.parent].second == node ? place.leaf : place.leaf + leaves_of(own);
    }
    MadeNodes(build.nodes).at[middle.leaf] = TreeNode(
        first.low, reference_of(first, place), first.high, parent,
        second.low, reference_of(second, middle), second.high, 0u
    );
}

void write_chunk() {
    uint root = build.lists.at[0];
    for (uint number = chunk_begin + thread; number < chunk_end; number += THREADS) {
        // Refits look at all slots.
        if (build.keeps_all != 0u && number < build.slot_count && number >= leaves_of(build.clusters.at[root])) {
            MadeNodes(build.nodes).at[number] = NO_NODE;
        }
        if (build.clusters.at[number].parent == UNHITTABLE) { continue; }
        write_leaf(number);
        // Behind the primitive that the root holds there is no node.
        if (number != build.clusters.at[root].parent) { write_node(build.count + number); }
    }
}

void write_entrance(uint count) {
    TreeNode entrance = NO_NODE;
    entrance.slot_count = build.slot_count;
    entrance.second = build.flat_tree.x;
    entrance.passed = build.flat_tree.y;
    if (count > 0u) {
        Cluster whole = build.clusters.at[build.lists.at[0]];
        entrance.first_low = whole.low;
        entrance.first_high = whole.high;
        entrance.first = reference_of(whole, Place(0u, 0u, false));
        entrance.second_low.x = cost_for_ray(whole.cost, half_area(whole.low, whole.high));
    }
    MadeNodes(build.nodes).at[0] = entrance;
}

#include "scene/trees/reinsertion.glsl"

void main() {
    thread = gl_LocalInvocationIndex;
    uvec2 part = work.parts.at[gl_WorkGroupID.x];
    build = work.builds.at[part.x];
    if (work.stage == WRITING_STAGE) {
        find_chunk(build.halvings, part.y, chunk_begin, chunk_end);
        write_chunk();
        return;
    }
    if (work.stage >= SORTING_STAGES) {
        sort_triangles(work.stage - SORTING_STAGES, part.y);
        return;
    }
    if (work.stage >= IMPROVING_STAGES) {
        improve(work.stage - IMPROVING_STAGES, THREADS * part.y + thread);
        return;
    }
    uint halvings = halvings_of(work.stage), count;
    find_chunk(halvings, part.y, chunk_begin, chunk_end);
    uint list = min(work.stage, 1u);
    bool is_final = work.stage > 0u || build.is_of_instances != 0u;
    for (attempt = 0u;; attempt++) {
        if (work.stage == 0u) {
            count = make_clusters();
        } else {
            uint before = halvings_of(work.stage - 1u);
            count = join_lists(before, part.y, before - halvings);
        }
        count = merge_chunk(count, list, halvings, work.stage);
        if (is_final || attempt == LAST_ATTEMPT || !has_too_many_leaves(count)) { break; }
    }
    if (halvings == 0u && thread == 0u) { write_entrance(count); }
    if (build.halvings == 0u) { write_chunk(); }
}
