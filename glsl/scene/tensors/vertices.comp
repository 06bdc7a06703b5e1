// Writes a tensor's positions (count, 3) or normals of vertices to a mesh's memory. Wrong ones leave what is there.
#version 460
#include "scene/tensors/numbers.glsl"

layout(local_size_x = 64) in;

layout(push_constant, scalar) uniform Work {
    Floats floats;
    Doubles doubles;  // the same memory
    Wrong wrong;
    Made target;
    uint is_double;
    uint count;
    uint what;
    uint step;      // from one vertex to the next in the target, in floats
    float largest;  // absolute value
} work;

// Whatever drivers think of NaN.
bool is_usable(float x) { return (floatBitsToUint(x) & 0x7F800000u) != 0x7F800000u && abs(x) <= work.largest; }

void main() {
    uint vertex = gl_GlobalInvocationID.x;
    if (vertex >= work.count) { return; }
    vec3 values;
    bool right = true;
    for (uint i = 0u; i < 3u; i++) {
        uint at = 3u * vertex + i;
        values[i] = work.is_double != 0u ? float(work.doubles.at[at]) : work.floats.at[at];
        right = right && is_usable(values[i]);
    }
    if (!right) {
        work.wrong.at[0] = wrong_thing(work.what, vertex);
        return;
    }
    for (uint i = 0u; i < 3u; i++) { work.target.at[work.step * vertex + i] = values[i]; }
}
