// Writes numbers of tensors to the records of materials: solari_vk/bound/material_tensors.py. Wrong ones leave what is
// there.
#version 460
#include "scene/tensors/numbers.glsl"

layout(local_size_x = 64) in;

struct Number {
    Floats floats;
    Doubles doubles;  // the same memory
    uint is_double;
    uint step;    // 0: all are the first one
    uint count;
    uint target;  // in floats from the first record on
    float low;
    float high;
    float scale;  // of numbers in records
    uint what;    // the subject and index of a refusal
    Wrong wrong;
};

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer Numbers { Number at[]; };

layout(push_constant, scalar) uniform Work {
    Numbers numbers;
    Made target;
    uint count;
} work;

void main() {
    if (gl_GlobalInvocationID.x >= work.count) { return; }
    Number number = work.numbers.at[gl_GlobalInvocationID.x];
    vec3 values;
    bool right = true;
    for (uint i = 0u; i < number.count; i++) {
        uint at = i * number.step;
        values[i] = number.is_double != 0u ? float(number.doubles.at[at]) : number.floats.at[at];
        bool is_finite = (floatBitsToUint(values[i]) & 0x7F800000u) != 0x7F800000u;  // whatever drivers think of NaN
        right = right && is_finite && values[i] >= number.low && values[i] <= number.high;
    }
    if (!right) {
        number.wrong.at[0] = number.what;
        return;
    }
    for (uint i = 0u; i < number.count; i++) { work.target.at[number.target + i] = values[i] * number.scale; }
}
