// Trees of boxes that rays traverse without the driver's acceleration structures: one over the triangles of all
// instances that never moved, in world space ("flat"); for the others one over the triangles of each mesh, and one over
// instances above them.
// solari_vk/gpu/trees/ makes their memory, build.comp builds them, and scene/trace_compute.glsl traverses them.
#ifndef SCENE_TREES_TREE_GLSL
#define SCENE_TREES_TREE_GLSL

#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_buffer_reference_uvec2 : require

// A node holds the boxes of both children, so that one load decides which of them a ray visits: Aila and Laine,
// "Understanding the Efficiency of Ray Traversal on GPUs" (2009). A child is the slot of a node, or a leaf. Slot 0 is
// the entrance, whose first child is the root; without a root it is NO_ROOT. It has no second child; in the tree of a
// mesh that moves second_low.x is the cost when it was built, and in a tree over instances flat_tree_of() is the
// address of the flat tree.
struct TreeNode {
    vec3 first_low;
    uint first;
    vec3 first_high;
    uint slot_count;  // in slot 0: of the whole tree; the leaves lie behind that many slots. Elsewhere the node above
    vec3 second_low;
    uint second;
    vec3 second_high;
    uint passed;      // while a refit runs: from the child that came first, else 0
};

// 0: there is none.
uvec2 flat_tree_of(TreeNode entrance) { return uvec2(entrance.second, entrance.passed); }

// A leaf's bits, from the highest: LEAF, the number of its primitives less one, and where the first of them is.
const uint LEAF = 1u << 31;
const uint LEAF_COUNT_SHIFT = 28u;
const uint LEAF_FIRST_MASK = (1u << LEAF_COUNT_SHIFT) - 1u;
const uint MAX_LEAF_TRIANGLES = 4u;
const uint NO_ROOT = 0u;
// No path from a root to a leaf has more nodes.
const uint MAX_TREE_HEIGHT = 48u;

struct TreeTriangle {
    vec3 a;
    uint number;  // of the triangle in the mesh
    vec3 b;
    uint slot;    // in a flat tree: of the instance, into the TreeSlots of the tree above
    vec3 c;
    uint unused;
};

struct TreeInstance {
    mat3x4 object_from_world;   // its columns are rows
    uvec2 nodes;                // of the mesh's tree
    uvec2 triangles;
    uint row;                   // into `instances`
    uint mask;
    uint flags;                 // VkGeometryInstanceFlagsKHR
    uint unused;
};

// An instance whose triangles are in the flat tree.
struct TreeSlot {
    mat3x4 object_from_world;   // its columns are rows
    uint row;
    uint mask;                  // 0: no such instance any more
    uint flags;                 // and IS_MIRRORED
    uint unused;
};

const uint IS_MIRRORED = 1u << 8u;  // above VkGeometryInstanceFlagsKHR

layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer TreeNodes { TreeNode at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer TreeTriangles { TreeTriangle at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer TreeInstances { TreeInstance at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer TreeSlots { TreeSlot at[]; };

const uint TREE_INSTANCE_BYTES = 80u;

// The address that lies `bytes` behind another.
uvec2 address_behind(uvec2 address, uint bytes) {
    uint carry;
    uint low = uaddCarry(address.x, bytes, carry);
    return uvec2(low, address.y + carry);
}

// Where the leaves of a tree of so many slots begin; slots are counted in 64 bytes, which may add up to more than 32
// bits have.
uvec2 leaves_behind(uvec2 nodes, uint slot_count) {
    uvec2 carried = address_behind(nodes, slot_count << 6u);
    return uvec2(carried.x, carried.y + (slot_count >> 26u));
}

// Where the slots of a tree over instances begin, of which it has no more than 2^24.
uvec2 slots_behind(uvec2 leaves, uint slot_count) { return address_behind(leaves, slot_count * TREE_INSTANCE_BYTES); }

#endif
