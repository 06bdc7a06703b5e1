// Matrices (count, 4, 4) of a tensor, and where they go: solari_vk/gpu/tensors/port.py.
#ifndef SCENE_TENSORS_MATRICES_GLSL
#define SCENE_TENSORS_MATRICES_GLSL

#include "scene/tensors/numbers.glsl"

layout(push_constant, scalar) uniform Work {
    Floats floats;    // the matrices
    Doubles doubles;  // the same memory
    Wrong wrong;      // a matrix that was refused
    Made first;       // records: world from object by columns; or rows of cameras' numbers
    Made second;      // records: world from object by rows
    uint is_double;
    uint step;         // from one matrix to the next, in numbers
    uint count;
    uint what;         // a number above 0 for the target
    uint first_offset;  // of records, in floats: where the first begins, and from one to the next
    uint first_step;
    uint second_offset;
    uint second_step;
    vec3 new_origin;  // from which the coordinates of what is placed shall count
} work;

const double LARGEST = 1e12;  // LARGEST_TRANSFORM of solari_vk/scene/checks.py

double element(uint index, uint row, uint column) {
    uint at = index * work.step + 4u * row + column;
    return work.is_double != 0u ? work.doubles.at[at] : double(work.floats.at[at]);
}

bool is_usable(double x) {
    return (unpackDouble2x32(x).y & 0x7FF00000u) != 0x7FF00000u && abs(x) <= LARGEST;  // whatever drivers think of NaN
}

struct Axes {
    precise dvec3 x, y, z, origin;
};

// Leaves what a matrix flattens a thickness of a ten-thousandth, as `thickened` of solari_vk/scene/matrices.py does.
void thicken(inout dvec3 columns[4]) {
    dvec3 x = columns[0], y = columns[1], z = columns[2];
    dvec3 cofactors[3] = dvec3[](cross(y, z), cross(z, x), cross(x, y));
    if (abs(dot(x, cofactors[0])) > 1e-9LF * sqrt(dot(x, x) * dot(y, y) * dot(z, z))) { return; }
    double area = sqrt(dot(cofactors[0], cofactors[0]) + dot(cofactors[1], cofactors[1])
        + dot(cofactors[2], cofactors[2]));
    double factor = area > 0.0LF ? 1e-4LF / sqrt(area) : 0.0LF;
    for (uint i = 0u; i < 3u; i++) { columns[i] += factor * cofactors[i]; }
}

// The columns of a matrix, which may_flatten gives a thickness; false if it isn't affine and invertible by the rules of
// check_transforms in solari_vk/batch/view_cameras.py, in which case the refusal is recorded.
bool read_axes(uint index, bool may_flatten, out Axes axes) {
    bool right = true;
    dvec3 columns[4];
    for (uint column = 0u; column < 4u; column++) {
        for (uint row = 0u; row < 3u; row++) {
            columns[column][row] = element(index, row, column);
            right = right && is_usable(columns[column][row]);
        }
        right = right && element(index, 3u, column) == (column == 3u ? 1.0 : 0.0);
    }
    if (may_flatten) { thicken(columns); }
    axes = Axes(columns[0], columns[1], columns[2], columns[3] - dvec3(work.new_origin));
    dvec3 x = columns[0], y = columns[1], z = columns[2];
    right = right && abs(dot(x, cross(y, z))) > 1e-9LF * sqrt(dot(x, x) * dot(y, y) * dot(z, z));
    if (!right) {
        work.wrong.at[0] = wrong_thing(work.what, index);
    }
    return right;
}

#endif
