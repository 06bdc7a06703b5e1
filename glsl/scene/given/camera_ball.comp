// Finds the ball around the cameras that cameras.comp has written: the middle of their bounds, and the largest distance
// from it.
#version 460
#include "scene/given/matrices.glsl"

layout(local_size_x = 256) in;

shared dvec3 lowest[gl_WorkGroupSize.x], highest[gl_WorkGroupSize.x];

dvec3 place(uint view) {
    dvec3 found;
    for (uint i = 0u; i < 3u; i++) { found[i] = work.first.at[(9u + i) * work.count + view]; }
    return found;
}

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
    precise dvec3 middle = (lowest[0] + highest[0]) / 2.0LF;
    vec3 center = vec3(middle);
    barrier();
    precise double largest = 0.0LF;
    for (uint view = thread; view < work.count; view += gl_WorkGroupSize.x) {
        precise dvec3 away = place(view) - dvec3(center);
        largest = max(largest, away.x * away.x + away.y * away.y + away.z * away.z);
    }
    highest[thread] = dvec3(largest);
    merge(thread);
    if (thread == 0u) {
        float ball[4] = { center.x, center.y, center.z, float(sqrt(highest[0].x)) };
        for (uint i = 0u; i < 4u; i++) { work.second.at[i] = ball[i]; }
    }
}
