// Writes numbers of tensors to the records of materials: solari_vk/bound/given_materials.py. Wrong ones leave what is
// there.
#version 460
#include "scene/given/numbers.glsl"

layout(local_size_x = 64) in;

struct Given {
    Floats floats;
    Doubles doubles;  // the same memory
    uint is_double;
    uint step;    // 0: all are the first one
    uint count;
    uint target;  // in floats from the first record on
    float low;
    float high;
    float scale;  // of numbers in records
    uint wrong;   // how a wrong one is noted
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer List { Given at[]; };

layout(push_constant, scalar) uniform Work {
    List given;
    Made target;
    Wrong wrong;
    uint count;
} work;

void main() {
    if (gl_GlobalInvocationID.x >= work.count) { return; }
    Given given = work.given.at[gl_GlobalInvocationID.x];
    vec3 values;
    bool right = true;
    for (uint i = 0u; i < given.count; i++) {
        uint at = i * given.step;
        values[i] = given.is_double != 0u ? float(given.doubles.at[at]) : given.floats.at[at];
        bool is_finite = (floatBitsToUint(values[i]) & 0x7F800000u) != 0x7F800000u;  // whatever drivers think of NaN
        right = right && is_finite && values[i] >= given.low && values[i] <= given.high;
    }
    if (!right) {
        work.wrong.at[0] = given.wrong;
        return;
    }
    for (uint i = 0u; i < given.count; i++) { work.target.at[given.target + i] = values[i] * given.scale; }
}
