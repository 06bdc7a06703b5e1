// What a build of a tree reads and makes of its primitives: their boxes, and leaves.
#ifndef SCENE_TREES_PRIMITIVES_GLSL
#define SCENE_TREES_PRIMITIVES_GLSL

#include "scene/trees/making.glsl"

// VkAccelerationStructureInstanceKHR, whose 24 bits of an offset are used otherwise.
struct InstanceRecord {
    vec4 world_from_object[3];  // rows
    uint row_and_mask;
    uint flags_and_slot;        // slot in the flat tree and one more; 0: not in that tree
    uvec2 mesh_tree;
};

const uint SLOT_BITS = 0xFFFFFFu;

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
    uint shape;   // its leaves, then in HEIGHT_BITS the nodes on the longest path to a leaf
};

const uint HEIGHT_BITS = 6u;

uint height_of(Cluster cluster) { return cluster.shape & ((1u << HEIGHT_BITS) - 1u); }
uint leaves_of(Cluster cluster) { return cluster.shape >> HEIGHT_BITS; }

layout(buffer_reference, scalar, buffer_reference_align = 16) coherent buffer Clusters { Cluster at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer List { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeNodes { TreeNode at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeTriangles { TreeTriangle at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeInstances { TreeInstance at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) writeonly buffer MadeSlots { TreeSlot at[]; };
// Of each triangle in a flat tree: its number in its mesh, and its instance's slot.
layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer TriangleTags { uvec2 at[]; };

struct TreeBuild {
    Corners corners;            // of a mesh
    Indices indices;
    uvec2 tags;                 // TriangleTags of a flat tree, or 0
    InstanceRecords instances;  // or of a scene
    uvec2 flat_tree;            // of the scene, or 0
    uvec2 nodes;                // what is made: slot_count nodes, then the leaves
    Clusters clusters;          // scratch: 2 * count
    List lists;                 // scratch: 4 * count
    uint count;                 // of triangles or instances
    uint slot_count;
    uint is_of_instances;
    uint keeps_all;             // triangles that no ray can hit too, since they may move
    uint halvings;              // of all primitives into chunks
    uint sorts_first;           // stages before the first one bring primitives into spatial order
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer TreeBuilds { TreeBuild at[]; };

TreeBuild build;

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

// The rows of the inverse of a transform that is given by rows.
mat3x4 inverse_of(vec4 rows[3]) {
    mat4 by_columns = transpose(mat4(rows[0], rows[1], rows[2], vec4(0.0, 0.0, 0.0, 1.0)));
    mat4 by_rows = transpose(inverse_by_elimination(by_columns));
    return mat3x4(by_rows[0], by_rows[1], by_rows[2]);
}

bool is_invertible(vec4 rows[3]) {
    mat3x4 inverted = inverse_of(rows);
    return is_finite(inverted[0].xyz) && is_finite(inverted[1].xyz) && is_finite(inverted[2].xyz);
}

// Returns whether rays can hit an instance in the tree over instances: one in the flat tree they can't, nor one without
// a mesh or whose mesh has no triangles.
bool instance_box(uint number, out vec3 low, out vec3 high) {
    InstanceRecord record = build.instances.at[number];
    low = high = vec3(0.0);
    if ((record.flags_and_slot & SLOT_BITS) != 0u) { return false; }
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
    return is_finite(low) && is_finite(high) && is_invertible(record.world_from_object);
}

void write_triangle(uint place, uint number) {
    uvec3 corners = build.indices.at[number];
    uvec2 tag = build.tags == uvec2(0u) ? uvec2(number, 0u) : TriangleTags(build.tags).at[number];
    MadeTriangles(leaves_behind(build.nodes, build.slot_count)).at[place] = TreeTriangle(
        build.corners.at[corners.x], tag.x, build.corners.at[corners.y], tag.y, build.corners.at[corners.z], 0u
    );
}

void write_instance(uint place, uint number) {
    InstanceRecord record = build.instances.at[number];
    TreeInstance made;
    made.object_from_world = inverse_of(record.world_from_object);
    made.nodes = record.mesh_tree;
    made.row = record.row_and_mask & 0xFFFFFFu;
    made.mask = record.row_and_mask >> 24u;
    made.flags = record.flags_and_slot >> 24u;
    made.triangles = leaves_behind(made.nodes, slots_of(made.nodes));
    made.unused = 0u;
    MadeInstances(leaves_behind(build.nodes, build.slot_count)).at[place] = made;
}

// Tells rays that meet a triangle in the flat tree about its instance.
void write_slot(uint number) {
    InstanceRecord record = build.instances.at[number];
    uint slot = record.flags_and_slot & SLOT_BITS;
    if (slot == 0u) { return; }
    TreeSlot made;
    made.object_from_world = inverse_of(record.world_from_object);
    made.row = record.row_and_mask & 0xFFFFFFu;
    made.mask = is_invertible(record.world_from_object) ? record.row_and_mask >> 24u : 0u;
    made.flags = record.flags_and_slot >> 24u;
    vec4 rows[3] = record.world_from_object;
    if (determinant(mat3(rows[0].xyz, rows[1].xyz, rows[2].xyz)) < 0.0) { made.flags |= IS_MIRRORED; }
    made.unused = 0u;
    MadeSlots(slots_behind(leaves_behind(build.nodes, build.slot_count), build.slot_count)).at[slot - 1u] = made;
}

#endif
