// Merging the clusters of a chunk. build.comp includes this behind what it declares.
#ifndef SCENE_TREES_CLUSTERS_GLSL
#define SCENE_TREES_CLUSTERS_GLSL

const uint ONE_LEAF = 1u << HEIGHT_BITS;  // Cluster.shape
// A tree has room for half as many leaves as triangles, which is enough for most meshes. A chunk that needs more is
// clustered again: then so few triangles are a leaf in any case, and others where this costs a ray no more than so many
// times what a node costs. In the last attempt triangles begin in pairs: of some that lie around others no two meet.
const uint LAST_ATTEMPT = 5u;
const uint SMALL_LEAVES[] = uint[](0u, 2u, 2u, 2u, 3u, 3u);
const float LEAF_COSTS[] = float[](1.0, 1.1, 1.2, 1.35, 1.35, 1.35);

// Where the chunk's lists are: two of clusters in turn, then what each cluster is nearest to, and sorted primitives.
uint list_at(uint list) { return list * build.count + chunk_begin; }
uint nearest_at() { return list_at(2u); }

// The number of a primitive in spatial order.
uint number_at(uint place) {
    return build.sorts_first != 0u ? build.lists.at[list_at(3u) + place] : chunk_begin + place;
}

// Makes a cluster of each primitive that rays can hit; returns their number. Their list is the first one.
uint make_clusters() {
    uint begin, end, found = 0u;
    own_part(chunk_end - chunk_begin, begin, end);
    for (uint place = begin; place < end; place++) {
        uint number = number_at(place);
        Cluster made;
        bool hittable = build.is_of_instances != 0u ? instance_box(number, made.low, made.high)
                                                    : triangle_box(number, made.low, made.high);
        made.first = made.second = number;
        made.cost = TRIANGLE_COST * half_area(made.low, made.high);
        made.size = 1u | IS_LEAF;
        made.parent = hittable ? number : UNHITTABLE;
        made.shape = ONE_LEAF;
        build.clusters.at[number] = made;
        if (build.is_of_instances != 0u) { write_slot(number); }
        found += hittable ? 1u : 0u;
    }
    uint total;
    uint made_end = list_at(0u) + sum_before(found, total);
    for (uint place = begin; place < end; place++) {
        uint number = number_at(place);
        if (build.clusters.at[number].parent != UNHITTABLE) { build.lists.at[made_end++] = number; }
    }
    wait_for_all();
    return total;
}

// Joins what the stage before left of 2^halvings chunks, as this chunk's second list; returns its length.
uint join_lists(uint halvings_before, uint chunk, uint halvings) {
    uint count = 0u;
    for (uint i = 0u; i < 1u << halvings; i++) {
        uint begin, end;
        find_chunk(halvings_before, (chunk << halvings) + i, begin, end);
        uint length = build.lists.at[2u * build.count + begin];
        if (thread < length) { build.lists.at[list_at(1u) + count + thread] = build.lists.at[begin + thread]; }
        count += length;
    }
    wait_for_all();
    return count;
}

// The place in a list of the cluster whose box together with that of another is smallest. max_height: of the node above
// both; where that would be too high, a cluster is its own nearest.
uint nearest_cluster(uint list, uint count, uint place, uint max_height) {
    Cluster own = build.clusters.at[build.lists.at[list + place]];
    uint first = uint(max(int(place) - SEARCH_RADIUS, 0)), last = min(place + uint(SEARCH_RADIUS), count - 1u);
    uint nearest = place;
    float least = INFINITY;
    for (uint other = first; other <= last; other++) {
        if (other == place) { continue; }
        Cluster candidate = build.clusters.at[build.lists.at[list + other]];
        float area = half_area(min(own.low, candidate.low), max(own.high, candidate.high));
        // Of equally near ones the one whose number differs in the lowest bits: both of such a pair choose each other.
        if (area < least || nearest == place || (area == least && (other ^ place) < (nearest ^ place))) {
            least = area;
            nearest = other;
        }
    }
    uint height = max(height_of(own), height_of(build.clusters.at[build.lists.at[list + nearest]]));
    return height < max_height ? nearest : place;
}

// Makes one cluster of two; returns its number.
uint merge(uint first, uint second) {
    Cluster a = build.clusters.at[first], b = build.clusters.at[second];
    uint node = build.count + b.parent;
    Cluster made;
    made.low = min(a.low, b.low);
    made.high = max(a.high, b.high);
    made.first = first;
    made.second = second;
    made.size = (a.size & ~IS_LEAF) + (b.size & ~IS_LEAF);
    made.shape = (leaves_of(a) + leaves_of(b) << HEIGHT_BITS) + max(height_of(a), height_of(b)) + 1u;
    float area = half_area(made.low, made.high);
    float as_node = NODE_COST * area + a.cost + b.cost;
    float as_leaf = TRIANGLE_COST * area * float(made.size);
    made.cost = as_node;
    bool is_leaf = made.size <= SMALL_LEAVES[attempt] || as_leaf <= LEAF_COSTS[attempt] * as_node;
    if (build.is_of_instances == 0u && made.size <= MAX_LEAF_TRIANGLES && is_leaf) {
        made.cost = as_leaf;
        made.size |= IS_LEAF;
        made.shape = ONE_LEAF;
    }
    made.parent = a.parent;
    build.clusters.at[node] = made;
    build.clusters.at[first].parent = node;
    build.clusters.at[second].parent = node;
    return node;
}

// One round: merges pairs, and writes the list of what is left behind `next`. Returns its length. by_place: pairs are
// neighbors in the list, so that the round halves it.
uint merge_pairs(uint list, uint next, uint count, uint max_height, bool by_place) {
    uint nearest = nearest_at();
    for (uint place = thread; place < count; place += THREADS) {
        uint other = by_place ? min(place ^ 1u, count - 1u) : nearest_cluster(list, count, place, max_height);
        build.lists.at[nearest + place] = other;
    }
    wait_for_all();
    uint begin, end, left = 0u;
    own_part(count, begin, end);
    for (uint place = begin; place < end; place++) {
        uint other = build.lists.at[nearest + place];
        bool is_pair = other != place && build.lists.at[nearest + other] == place;
        if (!is_pair || place < other) { left++; }
    }
    uint total;
    uint made = next + sum_before(left, total);
    for (uint place = begin; place < end; place++) {
        uint other = build.lists.at[nearest + place];
        bool is_pair = other != place && build.lists.at[nearest + other] == place;
        if (is_pair && place > other) { continue; }
        uint cluster = build.lists.at[list + place];
        build.lists.at[made++] = is_pair ? merge(cluster, build.lists.at[list + other]) : cluster;
    }
    wait_for_all();
    return total;
}

// Merges the clusters of this chunk, which are in one of its two lists, until few enough are left, or one in the last
// stage. Leaves them in the first list, and their number where the third one begins; returns it.
uint merge_chunk(uint count, uint list, uint halvings, uint stage) {
    uint left_halvings = halvings > 0u ? work.left_halvings : 0u;
    // So high may the clusters of this stage become: later stages need a level for each halving of all that is left,
    // and of the levels to spare each stage has an equal share.
    uint levels_later = halvings + left_halvings;
    uint stages_later = (halvings + work.stage_halvings - 1u) / work.stage_halvings;
    uint spare = MAX_TREE_HEIGHT - halvings_to_one(build.count);
    uint max_height = MAX_TREE_HEIGHT - levels_later - spare * stages_later / (stages_later + stage + 1u);
    bool by_place = attempt == LAST_ATTEMPT;
    for (uint round = 0u; count > 1u << left_halvings || (by_place && round == 0u); round++) {
        // Rounds by place make every cluster one higher, and so many of them are always enough from here on.
        uint rounds_left = max(halvings_to_one(count), left_halvings) - left_halvings;
        uint left = merge_pairs(list_at(list), list_at(1u - list), count, max_height - rounds_left, by_place);
        by_place = left == count || round >= MAX_ROUNDS;
        count = left;
        list = 1u - list;
    }
    if (list == 1u && thread < count) { build.lists.at[list_at(0u) + thread] = build.lists.at[list_at(1u) + thread]; }
    if (thread == 0u) { build.lists.at[nearest_at()] = count; }
    wait_for_all();
    return count;
}

// Whether the clusters that are left of this chunk have more leaves than the tree has room for.
bool has_too_many_leaves(uint count) {
    uint begin, end, leaves = 0u, total;
    own_part(count, begin, end);
    for (uint place = begin; place < end; place++) {
        leaves += leaves_of(build.clusters.at[build.lists.at[list_at(0u) + place]]);
    }
    sum_before(leaves, total);
    wait_for_all();
    return total > (chunk_end - chunk_begin + 1u) / 2u;
}

#endif
