// Improves trees that stay, step by step: parallel reinsertion (Meister and Bittner, "Parallel Reinsertion for
// Bounding Volume Hierarchy Optimization", 2018). Each subtree looks for the place where it adds least to the areas of
// boxes. Of subtrees whose moves change the same clusters only that one moves which gains most. Then boxes are computed
// anew, from the leaves up. build.comp includes this behind what it declares.
#ifndef SCENE_TREES_REINSERTION_GLSL
#define SCENE_TREES_REINSERTION_GLSL

const uint MAX_VISITS = 256u;  // of a search
const uint SEARCH_STACK = 64u;
const uint NO_TARGET = 0xFFFFFFFFu;
const float LEAST_GAIN = 1e-30;
const uint CLUSTER_WORDS = 12u;
const uint COST_WORD = 8u;

// Marks stand in place of costs, which nobody needs any more: what has claimed a cluster, by its gain and its number,
// or whether a child was fitted.
List marks() { return List(uvec2(build.clusters)); }
uint mark_at(uint cluster) { return CLUSTER_WORDS * cluster + COST_WORD; }

// The bits that a mark has for a cluster's number. The others are the highest ones of the gain.
uint number_bits() { return uint(findMSB(2u * build.count - 1u)) + 1u; }

// In the lists, of which the first one begins with the root.
uint target_at(uint cluster) { return build.count + cluster; }

bool is_in_tree(uint cluster) {
    if (cluster >= 2u * build.count) { return false; }
    uint number = cluster < build.count ? cluster : cluster - build.count;
    if (build.clusters.at[number].parent == UNHITTABLE) { return false; }
    return cluster < build.count || number != build.clusters.at[build.lists.at[0]].parent;
}

// Whether a cluster is below one that is a leaf as a whole. Those move together.
bool is_within_leaf(uint cluster) {
    uint above = build.clusters.at[cluster].parent;
    while (above >= build.count) {
        uint size = build.clusters.at[above].size;
        if ((size & IS_LEAF) != 0u) { return true; }
        if (size > MAX_LEAF_TRIANGLES) { return false; }
        above = build.clusters.at[above].parent;
    }
    return false;
}

uint sibling_of(uint cluster) {
    Cluster above = build.clusters.at[build.clusters.at[cluster].parent];
    return above.first == cluster ? above.second : above.first;
}

uint searched[SEARCH_STACK];
float left_of_gain[SEARCH_STACK];

// Beside which cluster a subtree, which isn't a child of the root, adds least; NO_TARGET if it is there already. gain:
// by how much the areas of all boxes become less.
uint find_target(uint moved, out float gain) {
    Cluster own = build.clusters.at[moved];
    float own_area = half_area(own.low, own.high);
    uint target = NO_TARGET, visits = 0u, below = moved, pivot = own.parent;
    float saved = half_area(build.clusters.at[pivot].low, build.clusters.at[pivot].high);
    vec3 low = vec3(INFINITY), high = vec3(-INFINITY);  // of the pivot without the subtree
    gain = LEAST_GAIN;
    while (pivot >= build.count && visits < MAX_VISITS) {
        Cluster above = build.clusters.at[pivot];
        uint sibling = above.first == below ? above.second : above.first, top = 1u;
        searched[0] = sibling;
        left_of_gain[0] = saved;
        for (; top > 0u && visits < MAX_VISITS; visits++) {
            uint node = searched[--top];
            float left = left_of_gain[top];
            Cluster seen = build.clusters.at[node];
            float widened = half_area(min(seen.low, own.low), max(seen.high, own.high));
            if (left - widened > gain) {
                gain = left - widened;
                target = node;
            }
            left -= widened - half_area(seen.low, seen.high);
            bool is_leaf = (seen.size & IS_LEAF) != 0u;
            if (is_leaf || left - own_area <= gain || top + 2u > SEARCH_STACK) { continue; }
            searched[top] = seen.first;
            searched[top + 1u] = seen.second;
            left_of_gain[top] = left_of_gain[top + 1u] = left;
            top += 2u;
        }
        low = min(low, build.clusters.at[sibling].low);
        high = max(high, build.clusters.at[sibling].high);
        // The parent goes with the subtree, and those above it become smaller.
        if (below != moved) { saved += half_area(above.low, above.high) - half_area(low, high); }
        below = pivot;
        pivot = above.parent;
    }
    return target;
}

bool mark(uint cluster, uint key, bool claims) {
    if (claims) { atomicMax(marks().at[mark_at(cluster)], key); }
    return claims || marks().at[mark_at(cluster)] == key;
}

uint depth_of(uint cluster) {
    uint depth = 0u;
    for (uint above = build.clusters.at[cluster].parent; above >= build.count; depth++) {
        above = build.clusters.at[above].parent;
    }
    return depth;
}

// Claims the clusters that a move changes, or returns whether all of them are claimed by it. Those above the target are
// among them, since they must not move below the subtree at the same time.
bool mark_move(uint moved, uint target, uint key, bool claims) {
    uint parent = build.clusters.at[moved].parent;
    bool all_marked = mark(moved, key, claims);
    all_marked = mark(parent, key, claims) && all_marked;
    all_marked = mark(sibling_of(moved), key, claims) && all_marked;
    all_marked = mark(build.clusters.at[parent].parent, key, claims) && all_marked;
    all_marked = mark(build.clusters.at[target].parent, key, claims) && all_marked;
    uint depth = depth_of(target), other = moved, other_depth = depth_of(moved);
    while (target != other) {
        if (depth >= other_depth) {
            all_marked = mark(target, key, claims) && all_marked;
            target = build.clusters.at[target].parent;
            depth--;
        } else {
            other = build.clusters.at[other].parent;
            other_depth--;
        }
    }
    return all_marked;
}

void replace_child(uint parent, uint child, uint other) {
    if (build.clusters.at[parent].first == child) {
        build.clusters.at[parent].first = other;
    } else {
        build.clusters.at[parent].second = other;
    }
    build.clusters.at[other].parent = parent;
}

void move_beside(uint moved, uint target) {
    uint parent = build.clusters.at[moved].parent;
    replace_child(build.clusters.at[parent].parent, parent, sibling_of(moved));
    replace_child(build.clusters.at[target].parent, target, parent);
    build.clusters.at[parent].first = target;
    build.clusters.at[parent].second = moved;
    build.clusters.at[target].parent = parent;
}

// Computes the clusters above a primitive anew; where two threads meet, the second goes on.
void fit_above(uint cluster) {
    for (uint node = build.clusters.at[cluster].parent; node >= build.count;) {
        memoryBarrierBuffer();
        if (atomicExchange(marks().at[mark_at(node)], 1u) == 0u) { return; }
        memoryBarrierBuffer();
        marks().at[mark_at(node)] = 0u;
        Cluster a = build.clusters.at[build.clusters.at[node].first];
        Cluster b = build.clusters.at[build.clusters.at[node].second];
        build.clusters.at[node].low = min(a.low, b.low);
        build.clusters.at[node].high = max(a.high, b.high);
        // Leaves move as they are.
        if ((build.clusters.at[node].size & IS_LEAF) == 0u) {
            build.clusters.at[node].size = (a.size & ~IS_LEAF) + (b.size & ~IS_LEAF);
            uint height = min(max(height_of(a), height_of(b)) + 1u, (1u << HEIGHT_BITS) - 1u);
            build.clusters.at[node].shape = (leaves_of(a) + leaves_of(b) << HEIGHT_BITS) + height;
        }
        node = build.clusters.at[node].parent;
    }
}

// A tree that has become too high stays in memory as it was.
void write_improved(uint number) {
    Cluster root = build.clusters.at[build.lists.at[0]];
    if (height_of(root) > MAX_TREE_HEIGHT) { return; }
    write_leaf(number);
    if (number != root.parent) { write_node(build.count + number); }
    if (number == root.parent) { write_entrance(1u); }
}

void improve(uint step, uint cluster) {
    if (!is_in_tree(cluster)) { return; }
    if (step == 0u) {
        marks().at[mark_at(cluster)] = 0u;
    } else if (step == 1u) {
        uint target = NO_TARGET, parent = build.clusters.at[cluster].parent;
        float gain;
        bool has_choice = parent >= build.count && build.clusters.at[parent].parent >= build.count;
        if (has_choice && !is_within_leaf(cluster)) {
            target = find_target(cluster, gain);
        }
        build.lists.at[target_at(cluster)] = target;
        if (target != NO_TARGET) {
            uint key = floatBitsToUint(gain) >> number_bits() << number_bits() | cluster;
            mark_move(cluster, target, key, true);
        }
    } else if (step == 2u) {
        uint target = build.lists.at[target_at(cluster)], key = marks().at[mark_at(cluster)];
        if (target == NO_TARGET) { return; }
        bool is_first = (key & (1u << number_bits()) - 1u) == cluster && mark_move(cluster, target, key, false);
        if (!is_first) { build.lists.at[target_at(cluster)] = NO_TARGET; }
    } else if (step == 3u) {
        uint target = build.lists.at[target_at(cluster)];
        if (target != NO_TARGET) { move_beside(cluster, target); }
        marks().at[mark_at(cluster)] = 0u;
    } else if (cluster < build.count) {
        if (step == 4u) { fit_above(cluster); } else { write_improved(cluster); }
    }
}

#endif
