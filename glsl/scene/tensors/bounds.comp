// Finds boxes around the corners of a mesh's triangles, one for each work group, or the box around such boxes.
#version 460
#include "scene/tensors/numbers.glsl"

layout(local_size_x = 256) in;

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Positions { vec3 at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Corners { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Boxes { vec3 at[]; };  // low, high

layout(push_constant, scalar) uniform Work {
    Positions positions;
    Corners corners;
    Boxes boxes;     // without corners: read too
    uint count;      // of corners, or boxes
    uint is_merging;
} work;

shared vec3 lowest[gl_WorkGroupSize.x], highest[gl_WorkGroupSize.x];

void include(uint i, inout vec3 low, inout vec3 high) {
    bool merges = work.is_merging != 0u;
    vec3 first = merges ? work.boxes.at[2u * i] : work.positions.at[work.corners.at[i]];
    low = min(low, first);
    high = max(high, merges ? work.boxes.at[2u * i + 1u] : first);
}

void main() {
    uint thread = gl_LocalInvocationID.x, begin = gl_GlobalInvocationID.x;
    vec3 low = vec3(uintBitsToFloat(0x7F7FFFFFu)), high = -low;
    for (uint i = begin; i < work.count; i += gl_NumWorkGroups.x * gl_WorkGroupSize.x) { include(i, low, high); }
    lowest[thread] = low;
    highest[thread] = high;
    for (uint half_count = gl_WorkGroupSize.x / 2u; half_count > 0u; half_count /= 2u) {
        barrier();
        if (thread < half_count) {
            lowest[thread] = min(lowest[thread], lowest[thread + half_count]);
            highest[thread] = max(highest[thread], highest[thread + half_count]);
        }
    }
    if (thread == 0u) {
        work.boxes.at[2u * gl_WorkGroupID.x] = lowest[0];
        work.boxes.at[2u * gl_WorkGroupID.x + 1u] = highest[0];
    }
}
