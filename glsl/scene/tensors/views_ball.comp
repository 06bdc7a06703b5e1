// Finds the ball around the cameras that views.comp has written: the middle of their bounds, and the largest distance
// from it.
#version 460
#include "scene/tensors/view_records.glsl"

layout(local_size_x = 256) in;

const uint BALL = 3u;  // ball_center, then ball_radius of ViewsBlock

shared vec3 lowest[gl_WorkGroupSize.x], highest[gl_WorkGroupSize.x];

vec3 place(uint view) { return work.views.at[view].current.world_from_view[3]; }

void merge(uint thread) {
    for (uint half_count = gl_WorkGroupSize.x / 2u; half_count > 0u; half_count /= 2u) {
        barrier();
        if (thread < half_count) {
            lowest[thread] = min(lowest[thread], lowest[thread + half_count]);
            highest[thread] = max(highest[thread], highest[thread + half_count]);
        }
    }
    barrier();
}

void main() {
    uint thread = gl_LocalInvocationID.x;
    lowest[thread] = highest[thread] = place(min(thread, work.count - 1u));
    for (uint view = thread; view < work.count; view += gl_WorkGroupSize.x) {
        lowest[thread] = min(lowest[thread], place(view));
        highest[thread] = max(highest[thread], place(view));
    }
    merge(thread);
    vec3 center = lowest[0] + (highest[0] - lowest[0]) / 2.0;
    barrier();
    float largest = 0.0;
    for (uint view = thread; view < work.count; view += gl_WorkGroupSize.x) {
        largest = max(largest, distance(place(view), center));
    }
    highest[thread] = vec3(largest);
    merge(thread);
    if (thread == 0u) {
        for (uint i = 0u; i < 3u; i++) { work.block.at[BALL + i] = floatBitsToUint(center[i]); }
        work.block.at[BALL + 3u] = floatBitsToUint(highest[0].x);
    }
}
