// Builds trees over triangles or instances, each by one workgroup: parallel locally-ordered clustering (Meister and
// Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", 2018). Primitives come in
// spatial order, so that near ones are close to each other in the list of clusters. In each round every cluster looks
// for its nearest one within SEARCH_RADIUS places, and clusters that are each other's nearest become one.
//
// The host gives all memory by address and puts barriers around this shader itself.
#version 460
#include "common/math.glsl"
#include "scene/trees/tree.glsl"

layout(local_size_x = 256) in;

const uint THREADS = 256u;
const int SEARCH_RADIUS = 12;
// Cluster.parent of what has none, and of primitives that no ray can hit.
const uint NO_NODE = 0xFFFFFFFFu;
const uint UNHITTABLE = 0u;  // the first primitive is no node
const uint IS_LEAF = 1u << 31;  // in Cluster.size: all of the subtree becomes one leaf
// Costs of the surface area heuristic (Goldsmith and Salmon 1987), of a node and of a triangle.
const float NODE_COST = 1.2;
const float TRIANGLE_COST = 1.0;

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Corners { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Indices { uvec3 at[]; };

// VkAccelerationStructureInstanceKHR.
struct InstanceRecord {
    vec4 world_from_object[3];  // rows
    uint row_and_mask;
    uint flags;                 // above 24 bits of an offset
    uvec2 mesh_tree;
};

layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer InstanceRecords { InstanceRecord at[]; };

// A subtree while the tree grows. Primitives are the first ones, by their numbers; the nodes above them follow.
struct Cluster {
    vec3 low;
    uint first;   // child
    vec3 high;
    uint second;
    float cost;   // of the surface area heuristic, times the root's area
    uint size;    // primitives
    uint parent;
    uint unused;
};

layout(buffer_reference, scalar, buffer_reference_align = 16) coherent buffer Clusters { Cluster at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer List { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeNodes { TreeNode at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeTriangles { TreeTriangle at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeInstances { TreeInstance at[]; };

struct TreeBuild {
    Corners corners;            // of a mesh
    Indices indices;
    InstanceRecords instances;  // or of a scene
    uvec2 nodes;                // what is made: slot_count nodes, then the leaves
    Clusters clusters;          // scratch: 2 * count
    List lists;                 // scratch: 3 * count
    uint count;                 // of triangles or instances
    uint slot_count;
    uint is_of_instances;
    uint keeps_all;             // triangles that no ray can hit too, since they may move
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer TreeBuilds { TreeBuild at[]; };

layout(push_constant, scalar) uniform Work {
    TreeBuilds builds;
} work;

shared uvec2 sums[THREADS];

TreeBuild build;
uint thread;

void wait_for_all() {
    memoryBarrierBuffer();
    memoryBarrierShared();
    barrier();
}

// The sum of the values of all threads before this one, and of all, to make a list without gaps: Hillis and Steele,
// "Data Parallel Algorithms" (1986).
uvec2 sum_before(uvec2 value, out uvec2 total) {
    sums[thread] = value;
    wait_for_all();
    uvec2 sum = value;
    for (uint step = 1u; step < THREADS; step *= 2u) {
        uvec2 other = thread >= step ? sums[thread - step] : uvec2(0u);
        wait_for_all();
        sum += other;
        sums[thread] = sum;
        wait_for_all();
    }
    total = sums[THREADS - 1u];
    wait_for_all();
    return sum - value;
}

// The part of a list that a thread has: [begin, end).
void own_part(uint count, out uint begin, out uint end) {
    uint share = (count + THREADS - 1u) / THREADS;
    begin = min(thread * share, count);
    end = min(begin + share, count);
}

float half_area(vec3 low, vec3 high) {
    vec3 size = high - low;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}

bool is_finite(vec3 v) { return all(lessThanEqual(abs(v), vec3(3.4028235e38))); }  // comparisons with NaN are false

// ---- primitives -------------------------------------------------------------------------------------

uint slots_of(uvec2 tree) { return TreeNodes(tree).at[0].slot_count; }

// Returns whether rays can hit a triangle.
bool triangle_box(uint number, out vec3 low, out vec3 high) {
    uvec3 corners = build.indices.at[number];
    vec3 a = build.corners.at[corners.x], b = build.corners.at[corners.y], c = build.corners.at[corners.z];
    low = min(min(a, b), c);
    high = max(max(a, b), c);
    bool finite = is_finite(a) && is_finite(b) && is_finite(c);
    if (!finite) { low = high = vec3(0.0); }
    return finite || build.keeps_all != 0u;
}

// The inverse by the steps by which Mesa's software device inverts the transforms of its instances, so that hits by
// compute are bit by bit those of ray queries: Gaussian elimination of the transposed matrix, where pivots come up by
// swaps of neighbors, and substitution from the last row.
mat4 inverse_by_elimination(mat4 matrix) {
    precise mat4 left = matrix, right = mat4(1.0);  // a column here is a row there
    for (int pivot = 0; pivot < 4; pivot++) {
        for (int row = 3; row > pivot; row--) {
            if (abs(left[row][pivot]) <= abs(left[row - 1][pivot])) { continue; }
            vec4 below = left[row], beside = right[row];
            left[row] = left[row - 1];
            right[row] = right[row - 1];
            left[row - 1] = below;
            right[row - 1] = beside;
        }
        for (int row = pivot + 1; row < 4; row++) {
            precise float factor = left[row][pivot] / left[pivot][pivot];
            left[row] -= factor * left[pivot];
            right[row] -= factor * right[pivot];
        }
    }
    for (int row = 3; row >= 0; row--) {
        right[row] *= 1.0 / left[row][row];
        for (int above = 0; above < row; above++) { right[above] -= right[row] * left[above][row]; }
    }
    return right;
}

mat4 object_from_world(InstanceRecord record) {
    vec4 rows[3] = record.world_from_object;
    return inverse_by_elimination(transpose(mat4(rows[0], rows[1], rows[2], vec4(0.0, 0.0, 0.0, 1.0))));
}

// Returns whether rays can hit an instance: one without a mesh they can't, nor one whose mesh has no triangles.
bool instance_box(uint number, out vec3 low, out vec3 high) {
    InstanceRecord record = build.instances.at[number];
    low = high = vec3(0.0);
    if (record.mesh_tree == uvec2(0u) || record.row_and_mask >> 24u == 0u) { return false; }
    TreeNode entrance = TreeNodes(record.mesh_tree).at[0];
    if (entrance.first == NO_ROOT) { return false; }
    // The box around a turned box: Arvo, "Transforming Axis-Aligned Bounding Boxes" (1990).
    vec3 center = 0.5 * entrance.first_low + 0.5 * entrance.first_high;
    vec3 half_size = entrance.first_high - center;
    for (uint axis = 0u; axis < 3u; axis++) {
        vec4 row = record.world_from_object[axis];
        float middle = dot(row.xyz, center) + row.w;
        float reach = dot(abs(row.xyz), half_size);
        // Rays are traced in the mesh's own space, from which these numbers differ by rounding.
        reach += 16.0 * ROUNDING_UNIT * (dot(abs(row.xyz), abs(center)) + abs(row.w) + reach);
        low[axis] = middle - reach;
        high[axis] = middle + reach;
    }
    mat4 inverted = object_from_world(record);
    bool is_invertible = is_finite(inverted[0].xyz) && is_finite(inverted[1].xyz) && is_finite(inverted[2].xyz);
    return is_finite(low) && is_finite(high) && is_invertible;
}

void write_triangle(uint place, uint number) {
    uvec3 corners = build.indices.at[number];
    MadeTriangles(leaves_behind(build.nodes, build.slot_count)).at[place] = TreeTriangle(
        build.corners.at[corners.x], number, build.corners.at[corners.y], 0u, build.corners.at[corners.z], 0u
    );
}

void write_instance(uint place, uint number) {
    InstanceRecord record = build.instances.at[number];
    mat4 by_rows = transpose(object_from_world(record));
    TreeInstance made;
    for (uint axis = 0u; axis < 3u; axis++) { made.object_from_world[axis] = by_rows[axis]; }
    made.nodes = record.mesh_tree;
    made.triangles = leaves_behind(record.mesh_tree, slots_of(record.mesh_tree));
    made.row = record.row_and_mask & 0xFFFFFFu;
    made.mask = record.row_and_mask >> 24u;
    made.flags = record.flags >> 24u;
    made.unused = 0u;
    MadeInstances(leaves_behind(build.nodes, build.slot_count)).at[place] = made;
}

// ---- clusters ---------------------------------------------------------------------------------------

// Makes a cluster of each primitive that rays can hit; returns their number. Their list is the first one.
uint make_clusters() {
    uint begin, end, found = 0u;
    own_part(build.count, begin, end);
    for (uint number = begin; number < end; number++) {
        Cluster made;
        bool hittable = build.is_of_instances != 0u ? instance_box(number, made.low, made.high)
                                                    : triangle_box(number, made.low, made.high);
        made.first = made.second = number;
        made.cost = TRIANGLE_COST * half_area(made.low, made.high);
        made.size = 1u | IS_LEAF;
        made.parent = hittable ? NO_NODE : UNHITTABLE;
        made.unused = 0u;
        build.clusters.at[number] = made;
        found += hittable ? 1u : 0u;
    }
    uvec2 total;
    uint place = sum_before(uvec2(found, 0u), total).x;
    for (uint number = begin; number < end; number++) {
        if (build.clusters.at[number].parent == NO_NODE) { build.lists.at[place++] = number; }
    }
    wait_for_all();
    return total.x;
}

// The place in a list of the cluster whose box together with that of another is smallest.
uint nearest_cluster(uint list, uint count, uint place) {
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
    return nearest;
}

// Makes one cluster of two.
void merge(uint node, uint first, uint second) {
    Cluster a = build.clusters.at[first], b = build.clusters.at[second];
    Cluster made;
    made.low = min(a.low, b.low);
    made.high = max(a.high, b.high);
    made.first = first;
    made.second = second;
    made.size = (a.size & ~IS_LEAF) + (b.size & ~IS_LEAF);
    float area = half_area(made.low, made.high);
    float as_node = NODE_COST * area + a.cost + b.cost;
    float as_leaf = TRIANGLE_COST * area * float(made.size);
    made.cost = as_node;
    if (build.is_of_instances == 0u && made.size <= MAX_LEAF_TRIANGLES && as_leaf <= as_node) {
        made.cost = as_leaf;
        made.size |= IS_LEAF;
    }
    made.parent = NO_NODE;
    made.unused = 0u;
    build.clusters.at[node] = made;
    build.clusters.at[first].parent = node;
    build.clusters.at[second].parent = node;
}

// One round: merges pairs, and writes the list of what is left behind `next`. Returns its length. by_place: pairs are
// neighbors in the list, so that each round halves it.
uint merge_pairs(uint list, uint next, uint count, uint first_node, bool by_place) {
    uint nearest = 2u * build.count;
    for (uint place = thread; place < count; place += THREADS) {
        uint other = by_place ? min(place ^ 1u, count - 1u) : nearest_cluster(list, count, place);
        build.lists.at[nearest + place] = other;
    }
    wait_for_all();
    uint begin, end;
    own_part(count, begin, end);
    uvec2 made = uvec2(0u);  // clusters of the next list, and those among them that are new
    for (uint place = begin; place < end; place++) {
        uint other = build.lists.at[nearest + place];
        bool is_pair = other != place && build.lists.at[nearest + other] == place;
        if (!is_pair || place < other) { made.x++; }
        if (is_pair && place < other) { made.y++; }
    }
    uvec2 total;
    uvec2 before = sum_before(made, total);
    for (uint place = begin; place < end; place++) {
        uint other = build.lists.at[nearest + place];
        bool is_pair = other != place && build.lists.at[nearest + other] == place;
        if (is_pair && place > other) { continue; }
        uint cluster = build.lists.at[list + place];
        if (is_pair) {
            uint node = first_node + before.y++;
            merge(node, cluster, build.lists.at[list + other]);
            cluster = node;
        }
        build.lists.at[next + before.x++] = cluster;
    }
    wait_for_all();
    return total.x;
}

// ---- from clusters to nodes -------------------------------------------------------------------------

// Where the primitives of a subtree begin in the order of the tree. within_leaf: whether it is part of a leaf.
uint place_of(uint cluster, out bool within_leaf) {
    uint place = 0u;
    within_leaf = false;
    uint parent = build.clusters.at[cluster].parent;
    while (parent != NO_NODE) {
        Cluster above = build.clusters.at[parent];
        if (above.second == cluster) { place += build.clusters.at[above.first].size & ~IS_LEAF; }
        within_leaf = within_leaf || (above.size & IS_LEAF) != 0u;
        cluster = parent;
        parent = above.parent;
    }
    return place;
}

// A child of a node. place: of its first primitive.
uint reference_of(Cluster child, uint place) {
    uint size = child.size & ~IS_LEAF;
    if ((child.size & IS_LEAF) != 0u) { return LEAF | (size - 1u) << LEAF_COUNT_SHIFT | place; }
    // Each node lies between two primitives, where its second child begins, and no two nodes lie between the same.
    return place + (build.clusters.at[child.first].size & ~IS_LEAF);
}

void write_leaves() {
    for (uint number = thread; number < build.count; number += THREADS) {
        if (build.clusters.at[number].parent == UNHITTABLE) { continue; }
        bool within_leaf;
        uint place = place_of(number, within_leaf);
        if (build.is_of_instances != 0u) { write_instance(place, number); } else { write_triangle(place, number); }
    }
}

void write_nodes(uint node_end) {
    for (uint node = build.count + thread; node < node_end; node += THREADS) {
        Cluster own = build.clusters.at[node];
        bool within_leaf;
        uint place = place_of(node, within_leaf);
        if (within_leaf || (own.size & IS_LEAF) != 0u) { continue; }
        Cluster first = build.clusters.at[own.first], second = build.clusters.at[own.second];
        uint middle = place + (first.size & ~IS_LEAF);
        MadeNodes(build.nodes).at[middle] = TreeNode(
            first.low, reference_of(first, place), first.high, 0u,
            second.low, reference_of(second, middle), second.high, 0u
        );
    }
}

void write_entrance(uint root, uint count) {
    TreeNode entrance = TreeNode(vec3(0.0), NO_ROOT, vec3(0.0), build.slot_count, vec3(0.0), 0u, vec3(0.0), 0u);
    if (count > 0u) {
        Cluster whole = build.clusters.at[root];
        entrance.first_low = whole.low;
        entrance.first_high = whole.high;
        entrance.first = reference_of(whole, 0u);
    }
    MadeNodes(build.nodes).at[0] = entrance;
}

void main() {
    thread = gl_LocalInvocationIndex;
    build = work.builds.at[gl_WorkGroupID.x];
    uint count = make_clusters();
    uint list = 0u, next = build.count, node_end = build.count;
    for (uint round = 0u; count > 1u; round++) {
        // Pairs by place halve the list, so that this many rounds are enough from here on.
        uint rounds_left = uint(findMSB(count - 1u)) + 1u;
        uint left = merge_pairs(list, next, count, node_end, round + rounds_left >= MAX_TREE_HEIGHT);
        node_end += count - left;
        count = left;
        uint before = list;
        list = next;
        next = before;
    }
    write_leaves();
    write_nodes(node_end);
    if (thread == 0u) { write_entrance(build.lists.at[list], count); }
}
