// Adds up for each cell how much this frame's samples differ from those of the previous frame that show the same
// surfaces, or the background. In a cell's sum the differences by noise and by the samples' places cancel out; those of
// light, colors and emission that change stay, and at silhouettes what doesn't change has no part in them.
// A pixel's history can't tell, since it has both sides of an edge. Only after edits of the scene: confidence.comp.
#version 460
#include "generated/passes/taa.glsl"  // CELL_SIZE
#include "passes/taa/history.glsl"

layout(local_size_x = 8, local_size_y = 8) in;  // pixels of whole cells

shared SampleChange changes[gl_WorkGroupSize.x * gl_WorkGroupSize.y];

const uint TO_NEAREST = 0x20080200u;  // one half for each channel, in place of random numbers

// The pixel of the previous frame that showed what a pixel shows; outside of the picture if there is none.
ivec2 find_previous(ivec2 pixel) {
    ivec2 before = ivec2(floor(vec2(pixel) + 0.5 + motion_in_picture(pixel) * render_scale()));
    if (!is_inside(before, camera.size)) { return ivec2(-1); }
    float now = imageLoad(depth, texel_of(pixel)).x, then = imageLoad(previous_depth, texel_of(before)).x;
    bool near = abs(now - then) <= MAX_DEPTH_DIFFERENCE * max(now, then);
    bool same = imageLoad(gbuffer_surface, texel_of(pixel)).y == previous_instance(texel_of(before));
    return near && same ? before : ivec2(-1);
}

// Keeps a pixel's sample for the next frame, and returns its difference.
SampleChange find_change(ivec2 pixel) {
    SampleChange change = SampleChange(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    vec3 now = load_sample(pixel);
    taa_samples.at[element_index(pixel, camera.size)] = pack_color(now, TO_NEAREST);
    if (this_frame.has_history == 0u || this_frame.expected_change == 0.0 || !is_finite_color(now)) { return change; }
    ivec2 previous = find_previous(pixel);
    if (previous.x < 0) { return change; }
    vec3 before = unpack_color(previous_taa_samples.at[element_index(previous, camera.size)]);
    vec3 difference = now - before, larger = max(now, before);
    change.difference_sum = difference;
    change.sum_of_squares = difference * difference;
    change.sum_of_max = larger;
    change.sum_of_sizes = abs(difference);
    change.sum_of_shares = difference * difference / max(larger, MIN_CHANNEL * max_component(larger) + 1e-30);
    return change;
}

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy / CELL_SIZE, within = gl_GlobalInvocationID.xy % CELL_SIZE;
    uvec2 cells = (camera.size + CELL_SIZE - 1u) / CELL_SIZE;
    uint cell_index, own = gl_LocalInvocationIndex;
    bool is_cell = taa_settings.antialiasing != 0u && find_element(cell, cells, cell_index);
    uvec2 pixel = cell * CELL_SIZE + within;
    changes[own] = SampleChange(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    if (is_cell && is_inside(pixel, camera.size)) { changes[own] = find_change(ivec2(pixel)); }
    if (all_views.expected_change == 0.0) { return; }  // the same for the whole workgroup, before its barrier
    memoryBarrierShared();
    barrier();
    if (!is_cell || within != uvec2(0u)) { return; }
    SampleChange sum = changes[own];
    for (uint i = 1u; i < CELL_SIZE * CELL_SIZE; i++) {
        add_change(sum, changes[own + i / CELL_SIZE * gl_WorkGroupSize.x + i % CELL_SIZE]);
    }
    taa_changes.at[cell_index] = sum;
}
