// What deform.comp reads and writes: the host gives all memory by address (solari_vk/bound/scene_poses.py).
#ifndef SCENE_POSED_GLSL
#define SCENE_POSED_GLSL

#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_buffer_reference_uvec2 : require

struct Joint {
    mat4x3 object_from_bind;  // from the mesh in its bind pose to the instance's space
};

struct Influence {
    uint joint;
    float weight;
};

struct ActiveTarget {
    uint target;
    float weight;
};

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Given { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Made { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Influences { Influence at[]; };

// One posed mesh. Attributes are records of floats, of which only the normal and the tangent are written.
struct PosedMesh {
    Given rest_positions;
    Given rest_attributes;
    Influences influences;  // influence_count for each vertex; their weights add up to 1, or all are 0
    Given targets;          // for each target and vertex target_width floats: position, then normal and tangent, if any
    Made positions;
    Made attributes;
    uint vertex_count;
    uint influence_count;   // 0 without a skin
    uint first_joint;
    uint target_count;      // of those with a weight
    uint first_target;
    uint target_width;
    uint target_normal;     // floats before it; 0 without one, as in the next lines
    uint target_tangent;
    uint attribute_width;
    uint normal;            // floats before it in the attributes; NO_PART without one
    uint tangent;
};

const uint NO_PART = 0xFFFFFFFFu;

#endif
