// Writes a tensor's transforms of an instance in each world to the records of instances, for shaders and for rays.
#version 460
#include "scene/tensors/matrices.glsl"

layout(local_size_x = 64) in;

void main() {
    uint world = gl_GlobalInvocationID.x;
    Axes axes;
    // a wrong one leaves the instance where it was
    if (world >= work.count || !read_axes(world, true, axes)) { return; }
    uint columns = work.first_offset + world * work.first_step, rows = work.second_offset + world * work.second_step;
    for (uint row = 0u; row < 3u; row++) {
        vec4 values = vec4(axes.x[row], axes.y[row], axes.z[row], axes.origin[row]);
        for (uint column = 0u; column < 4u; column++) {
            work.first.at[columns + 3u * column + row] = values[column];
            work.second.at[rows + 4u * row + column] = values[column];
        }
    }
}
