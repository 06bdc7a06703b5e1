// Begins a wave: sets its indirect dispatch, which has a layer for each view, with as many threads as the longest queue
// has paths. Wave 0 traces first rays: for sample 0 with frame_ms those of choose_pixels.comp's pixels, for further
// samples those of pixels with a short history. Without frame_ms those of sample 0 are a direct dispatch over all
// pixels.
#version 460
#include "generated/passes/paths.glsl"  // LAST_WAVE, written by solari_vk/passes/paths.py
#include "passes/views.glsl"
#include "passes/paths/bindings.glsl"  // and passes/rows.glsl: make_indirect_squares

layout(local_size_x = GROUP_SIZE) in;

layout(constant_id = wave_index_id) const uint wave_index = 0u;
layout(constant_id = sample_index_id) const uint sample_index = 0u;
layout(constant_id = pixels_are_chosen_id) const bool pixels_are_chosen = false;
// Fewer paths than this wait for the last wave, which traces them to their ends. A wave of few paths takes as long as
// its longest ray, and all waves of few together longer than the longest path.
layout(constant_id = few_paths_id) const uint few_paths = 0u;
layout(constant_id = is_last_wave_id) const bool is_last_wave = false;

shared uint most;

uint longest_queue() {
    for (uint view = gl_LocalInvocationIndex; view < view_count(); view += GROUP_SIZE) {
        atomicMax(most, paths_queues.at[view].queued);
    }
    barrier();
    return most;
}

void main() {
    if (gl_LocalInvocationIndex == 0u) { most = 0u; }
    barrier();
    if (few_paths > 0u && longest_queue() * view_count() < few_paths) {
        if (gl_LocalInvocationIndex == 0u) { paths_wave.dispatch = make_indirect_squares(0u, 0u); }
        return;
    }
    for (uint view = gl_LocalInvocationIndex; view < view_count(); view += GROUP_SIZE) {
        PathQueue queue = paths_queues.at[view];
        queue.count = queue.queued;
        queue.queued = 0u;
        if (wave_index == 0u && sample_index == 0u) { queue.short_history_count = 0u; }
        paths_queues.at[view] = queue;
        atomicMax(most, wave_index == 0u ? queue.short_history_count : queue.count);
    }
    if (pixels_are_chosen && sample_index == 0u && gl_LocalInvocationIndex == 0u) {
        if (wave_index == 0u) { atomicMax(most, paths_chosen.count); } else { paths_chosen.count = 0u; }
    }
    barrier();
    if (gl_LocalInvocationIndex != 0u) { return; }
    paths_wave.sample_index = sample_index;
    uint index = wave_index == 0u ? 0u : paths_wave.index + 1u;
    // Of the two indices from LAST_WAVE on, the one that has the queue in which the paths wait.
    paths_wave.index = is_last_wave ? LAST_WAVE + (LAST_WAVE + index) % 2u : index;
    bool lists_all_views = pixels_are_chosen && wave_index == 0u && sample_index == 0u;  // paths_chosen
    paths_wave.dispatch = make_indirect_squares(most, lists_all_views ? 1u : view_count());
}
