// Paths that wait for their next ray. They are traced in waves: each is a dispatch over the paths that are left,
// because a subgroup would otherwise wait for the few of its threads with long paths. Laine, Karras and Aila,
// "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/pack_path.glsl"
#include "passes/paths/short_history.glsl"

// The index in paths_ray_queues where this view's queue of a wave begins: that of the view's first pixel, in the half
// for even or for odd waves.
uint queue_begin(uint wave_index) {
    return wave_index % 2u * (paths_ray_queues.at.length() / 2u) + element_index(uvec2(0u), camera.size);
}

// The pixel of an invocation in wave 0. First paths: each pixel of the picture, or with frame_ms those of
// choose_pixels.comp. Further paths: the pixels with a short history. `index`: the pixel's in buffers.
bool find_pixel_of_path(uint sample_index, out uvec2 pixel, out uint index) {
    pixel = INVOCATION_INDEX;  // gl_GlobalInvocationID.xy, or in a ray pipeline gl_LaunchIDEXT.xy
    if (sample_index == 0u && max_timed_samples == 0u) { return find_pixel(pixel, index); }
    choose_view(INVOCATION_LAYER);  // a dispatch over a list has a layer for each view
    uint thread = thread_index_in_squares(pixel);  // within the layer: passes/rows.glsl
    if (sample_index == 0u) {
        if (thread >= paths_chosen.count) { return false; }
        index = paths_chosen.at[thread];
    } else {
        if (thread >= paths_queues.at[view_index].short_history_count) { return false; }
        index = paths_short_histories.at[element_index(uvec2(0u), camera.size) + thread];
    }
    pixel = find_pixel_of(index);
    return true;
}

// The pixel whose path goes on in this wave.
bool find_waiting_path(out uvec2 pixel, out uint index) {
    if (paths_wave.index == 0u) {
        bool inside = find_pixel_of_path(paths_wave.sample_index, pixel, index);
        return inside && paths_states.at[index].flags != NO_PATH_STATE;
    }
    choose_view(INVOCATION_LAYER);
    uint thread = thread_index_in_squares(INVOCATION_INDEX);
    if (thread >= paths_queues.at[view_index].count) { return false; }
    index = paths_ray_queues.at[queue_begin(paths_wave.index) + thread];
    pixel = find_pixel_of(index);
    return true;
}

void queue_path(uint pixel_index, uint wave_index) {
    uint queue_index = atomicAdd(paths_queues.at[view_index].queued, 1u);
    paths_ray_queues.at[queue_begin(wave_index) + queue_index] = pixel_index;
}

void store_path_state(Path path, uint pixel_index) { paths_states.at[pixel_index] = pack_path(path); }

Path load_path_state(uint pixel_index) { return unpack_path(paths_states.at[pixel_index]); }

#endif
