// Makes the records of a batch's views for the next frame, of which the host writes no more than what has changed:
// solari_vk/bound/view_table.py.
#version 460
#include "scene/camera_records.glsl"
#include "scene/given/numbers.glsl"

layout(local_size_x = 64) in;

// What changes seldom: cameras without poses and jitter, and frames without index, has_history and sample_offset.
struct GivenView {
    Camera camera;
    FrameValues frame;
    uint world;
    uint first_instance;
};

layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Views { View at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer GivenViews { GivenView at[]; };

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer FrameOfViews {
    uint shared_values[3];  // the first ones of ViewsBlock in glsl/scene/camera_block.glsl
    uint index;
    Floats poses;  // rows with a number for each view: world_from_view, then view_from_world
    Floats ball;   // around all cameras: the center, and the radius
    float own_ball[4];
    float rows[];  // own poses, jitter, sample_offset, and what isn't 0 for views without history
};

layout(push_constant, scalar) uniform Work {
    Words block;   // ViewsBlock
    Views views;   // its records
    GivenViews given;
    FrameOfViews frame;
    uint count;
} work;

const uint JITTER = 24u, SAMPLE_OFFSET = 26u, CUT = 28u;  // rows

vec3 pose_row(uint first, uint view) {
    vec3 row;
    for (uint i = 0u; i < 3u; i++) { row[i] = work.frame.poses.at[(first + i) * work.count + view]; }
    return row;
}

float number(uint row, uint view) { return work.frame.rows[row * work.count + view]; }

void main() {
    uint view = gl_GlobalInvocationID.x;
    if (view >= work.count) { return; }
    if (view == 0u) {
        for (uint i = 0u; i < 3u; i++) { work.block.at[i] = work.frame.shared_values[i]; }
        for (uint i = 0u; i < 4u; i++) { work.block.at[3u + i] = floatBitsToUint(work.frame.ball.at[i]); }
    }
    bool has_history = number(CUT, view) == 0.0;
    GivenView given = work.given.at[view];
    Camera now = given.camera;
    for (uint column = 0u; column < 4u; column++) {
        now.world_from_view[column] = pose_row(3u * column, view);
        now.view_from_world[column] = pose_row(12u + 3u * column, view);
    }
    now.jitter = vec2(number(JITTER, view), number(JITTER + 1u, view));
    Camera previous = now;
    if (has_history) { previous = work.views.at[view].current; }
    FrameValues frame = given.frame;
    frame.index = work.frame.index;
    frame.has_history = uint(has_history);
    frame.sample_offset = vec2(number(SAMPLE_OFFSET, view), number(SAMPLE_OFFSET + 1u, view));
    uint previous_first_instance = work.views.at[view].first_instance;
    work.views.at[view] = View(now, previous, frame, given.world, given.first_instance, previous_first_instance);
}
