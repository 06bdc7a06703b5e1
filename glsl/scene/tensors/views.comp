// Makes the records of a batch's views for the next frame: of the numbers that the host gives for each frame, of those
// that it gives when they change, and of the cameras so far, which become the previous ones. See
// solari_vk/batch/view_buffer.py.
#version 460
#include "scene/tensors/view_records.glsl"

layout(local_size_x = 64) in;

const uint JITTER = 24u, SAMPLE_JITTER = 26u, CUT = 28u;  // rows

vec3 pose_column(uint first, uint view) {
    vec3 column;
    for (uint i = 0u; i < 3u; i++) { column[i] = work.frame.matrices.at[(first + i) * work.count + view]; }
    return column;
}

float number(uint row, uint view) { return work.frame.rows[row * work.count + view]; }

void main() {
    uint view = gl_GlobalInvocationID.x;
    if (view >= work.count) { return; }
    if (view == 0u) {
        for (uint i = 0u; i < 3u; i++) { work.block.at[i] = work.frame.shared_values[i]; }
    }
    bool has_history = number(CUT, view) == 0.0;
    ViewInput seldom = work.inputs.at[view];
    Camera now = seldom.camera;
    for (uint column = 0u; column < 4u; column++) {
        now.world_from_view[column] = pose_column(3u * column, view);
        now.view_from_world[column] = pose_column(12u + 3u * column, view);
    }
    now.jitter = vec2(number(JITTER, view), number(JITTER + 1u, view));
    Camera previous = now;
    if (has_history) { previous = work.views.at[view].current; }
    FrameValues frame = seldom.frame;
    frame.index = work.frame.index;
    frame.has_history = uint(has_history);
    frame.sample_jitter = vec2(number(SAMPLE_JITTER, view), number(SAMPLE_JITTER + 1u, view));
    uint previous_first_instance = work.views.at[view].first_instance;
    work.views.at[view] = View(now, previous, frame, seldom.world, seldom.first_instance, previous_first_instance);
}
