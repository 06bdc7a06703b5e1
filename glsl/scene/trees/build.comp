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
#include "scene/trees/making.glsl"

layout(local_size_x = 256) in;

const int SEARCH_RADIUS = 12;
const uint MAX_ROUNDS = 48u;          // in which the nearest are looked for
const uint UNHITTABLE = 0xFFFFFFFFu;  // Cluster.parent of primitives that no ray can hit
const uint IS_LEAF = 1u << 31;        // in Cluster.size: all of the subtree becomes one leaf
const uint WRITING_STAGE = 0xFFFFFFFFu;

// VkAccelerationStructureInstanceKHR.
struct InstanceRecord {
    vec4 world_from_object[3];  // rows
    uint row_and_mask;
    uint flags;                 // above 24 bits of an offset
    uvec2 mesh_tree;
};

layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer InstanceRecords { InstanceRecord at[]; };

// A subtree while the tree grows. Primitives are the first ones, by their numbers; the nodes above them follow. Their
// numbers don't depend on the order of threads: each cluster without a parent holds the number of a primitive below it
// that no other one holds. A new node stands at the number of its second child, behind all primitives, and goes on to
// hold that of its first.
struct Cluster {
    vec3 low;
    uint first;   // child
    vec3 high;
    uint second;
    float cost;   // of the surface area heuristic, times the root's area
    uint size;    // primitives
    uint parent;  // or below build.count, while there is none, the number that the cluster holds
    uint height;  // nodes on the longest path to a leaf
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
    uint halvings;              // of all primitives into chunks
    uint unused;
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer TreeBuilds { TreeBuild at[]; };

layout(push_constant, scalar) uniform Work {
    TreeBuilds builds;
    Parts parts;  // builds and chunks
    uint stage;
    uint stage_halvings;  // which each stage undoes
    uint left_halvings;   // of a chunk up to 2^left_halvings clusters are left
} work;

shared uint sums[THREADS];

TreeBuild build;
uint thread;
// The primitives of this workgroup's chunk: [chunk_begin, chunk_end). Its lists have the same place among all.
uint chunk_begin;
uint chunk_end;

void wait_for_all() {
    memoryBarrierBuffer();
    memoryBarrierShared();
    barrier();
}

// The sum of the values of all threads before this one, and of all, to make a list without gaps: Hillis and Steele,
// "Data Parallel Algorithms" (1986).
uint sum_before(uint value, out uint total) {
    sums[thread] = value;
    wait_for_all();
    uint sum = value;
    for (uint step = 1u; step < THREADS; step *= 2u) {
        uint other = thread >= step ? sums[thread - step] : 0u;
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

#include "scene/trees/clusters.glsl"

// ---- from clusters to nodes -------------------------------------------------------------------------

// Where the primitives of a subtree begin in the order of the tree. within_leaf: whether it is part of a leaf.
uint place_of(uint cluster, out bool within_leaf) {
    uint place = 0u;
    within_leaf = false;
    uint parent = build.clusters.at[cluster].parent;
    while (parent >= build.count) {
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

void write_leaf(uint number) {
    bool within_leaf;
    uint place = place_of(number, within_leaf);
    if (build.is_of_instances != 0u) { write_instance(place, number); } else { write_triangle(place, number); }
}

void write_node(uint node) {
    Cluster own = build.clusters.at[node];
    bool within_leaf;
    uint place = place_of(node, within_leaf);
    Cluster first = build.clusters.at[own.first], second = build.clusters.at[own.second];
    uint middle = place + (first.size & ~IS_LEAF);
    if (within_leaf || (own.size & IS_LEAF) != 0u) {
        // Refits look at all slots.
        MadeNodes(build.nodes).at[middle] = NO_NODE;
        return;
    }
    uint parent = 0u;
    if (own.parent >= build.count) {
        parent = build.clusters.at[own.parent].second == node ? place : place + (own.size & ~IS_LEAF);
    }
    MadeNodes(build.nodes).at[middle] = TreeNode(
        first.low, reference_of(first, place), first.high, parent,
        second.low, reference_of(second, middle), second.high, 0u
    );
}

void write_chunk() {
    uint root = build.lists.at[0];
    for (uint number = chunk_begin + thread; number < chunk_end; number += THREADS) {
        if (build.clusters.at[number].parent == UNHITTABLE) { continue; }
        write_leaf(number);
        // Behind the primitive that the root holds there is no node.
        if (number != build.clusters.at[root].parent) { write_node(build.count + number); }
    }
}

void write_entrance(uint count) {
    TreeNode entrance = NO_NODE;
    entrance.slot_count = build.slot_count;
    if (count > 0u) {
        Cluster whole = build.clusters.at[build.lists.at[0]];
        entrance.first_low = whole.low;
        entrance.first_high = whole.high;
        entrance.first = reference_of(whole, 0u);
        entrance.second_low.x = cost_for_ray(whole.cost, whole.low, whole.high);
    }
    MadeNodes(build.nodes).at[0] = entrance;
}

void main() {
    thread = gl_LocalInvocationIndex;
    uvec2 part = work.parts.at[gl_WorkGroupID.x];
    build = work.builds.at[part.x];
    if (work.stage == WRITING_STAGE) {
        find_chunk(build.halvings, part.y, chunk_begin, chunk_end);
        write_chunk();
        return;
    }
    uint halvings = halvings_of(work.stage), count;
    find_chunk(halvings, part.y, chunk_begin, chunk_end);
    if (work.stage == 0u) {
        count = merge_chunk(make_clusters(), 0u, halvings, 0u);
    } else {
        uint before = halvings_of(work.stage - 1u);
        count = merge_chunk(join_lists(before, part.y, before - halvings), 1u, halvings, work.stage);
    }
    if (halvings == 0u && thread == 0u) { write_entrance(count); }
    if (build.halvings == 0u) { write_chunk(); }
}
