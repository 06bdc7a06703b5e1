// Makes matrices of a tensor's transforms for views.comp, as camera_matrices of solari_vk/batch/view_cameras.py makes
// them: the same operations in the same order on doubles.
#version 460
#include "scene/tensors/matrices.glsl"

layout(local_size_x = 64) in;

dvec3 unit(dvec3 v) {
    precise double length = sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
    return dvec3(v.x / length, v.y / length, v.z / length);
}

// A row of the inverse is the cross product of the other two axes, over the volume of all three.
dvec3 inverse_row(dvec3 u, dvec3 v, double volume) {
    precise dvec3 made = dvec3(u.y * v.z - v.y * u.z, v.x * u.z - u.x * v.z, u.x * v.y - v.x * u.y);
    return dvec3(made.x / volume, made.y / volume, made.z / volume);
}

double shift(dvec3 row, dvec3 origin) {
    precise double moved = -row.x * origin.x - row.y * origin.y - row.z * origin.z;
    return moved;
}

void write(uint row, uint view, double number) { work.first.at[row * work.count + view] = float(number); }

void main() {
    uint view = gl_GlobalInvocationID.x;
    if (view >= work.count) { return; }
    Axes axes;
    if (!read_axes(view, false, axes)) { axes = Axes(dvec3(1, 0, 0), dvec3(0, 1, 0), dvec3(0, 0, 1), dvec3(0)); }
    precise dvec3 x = unit(axes.x), y = unit(axes.y), z = unit(axes.z), origin = axes.origin;
    precise double volume = x.x * (y.y * z.z - y.z * z.y) + x.y * (y.z * z.x - y.x * z.z)
        + x.z * (y.x * z.y - y.y * z.x);
    precise dvec3 rows[3] = { inverse_row(y, z, volume), inverse_row(z, x, volume), inverse_row(x, y, volume) };
    dvec3 columns[4] = { x, y, z, origin };
    for (uint row = 0u; row < 3u; row++) {
        for (uint column = 0u; column < 4u; column++) {
            write(3u * column + row, view, columns[column][row]);
            write(12u + 3u * column + row, view, column < 3u ? rows[row][column] : shift(rows[row], origin));
        }
    }
}
