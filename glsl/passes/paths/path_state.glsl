// Paths that wait for their next ray. They are traced in waves: each is a dispatch over the paths that are left,
// because a subgroup would otherwise wait for the few of its threads with long paths. Laine, Karras and Aila,
// "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/pack_path.glsl"
#include "passes/paths/short_history.glsl"

// ---- what buffers keep of the path of each pixel, by the pixel's index ---------------------------------

uint path_count() { return view_count() * camera.size.x * camera.size.y; }

void store_path_state(Path path, uint index) {
    PathState state = pack_path(path);
    for (uint i = 0u; i < STATE_QUADS; i++) { paths_states.quads[i * path_count() + index] = state.quads[i]; }
}

PathState load_path_state(uint index) {
    PathState state;
    for (uint i = 0u; i < STATE_QUADS; i++) { state.quads[i] = paths_states.quads[i * path_count() + index]; }
    return state;
}

void store_no_path_state(uint index) { paths_states.quads[index].w = NO_PATH_STATE; }

bool has_path_state(uint index) { return paths_states.quads[index].w != NO_PATH_STATE; }

void store_path_rays(Path path, uint index) {
    PathRays rays = pack_rays(path);
    for (uint i = 0u; i < RAYS_QUADS; i++) { paths_rays.quads[i * path_count() + index] = rays.quads[i]; }
}

// A path that waits for its rays to be traced.
Path load_path_with_rays(uint index) {
    PathRays rays;
    for (uint i = 0u; i < RAYS_QUADS; i++) { rays.quads[i] = paths_rays.quads[i * path_count() + index]; }
    return unpack_path(load_path_state(index), rays);
}

void store_path_hit(TracedRays traced, uint rng, uint index) {
    PathHit hit = pack_hit(traced, rng);
    for (uint i = 0u; i < HIT_QUADS; i++) { paths_hits.quads[i * path_count() + index] = hit.quads[i]; }
}

TracedRays load_path_hit(uint index, out uint rng) {
    PathHit hit;
    for (uint i = 0u; i < HIT_QUADS; i++) { hit.quads[i] = paths_hits.quads[i * path_count() + index]; }
    return unpack_hit(hit, rng);
}

// ---- queues --------------------------------------------------------------------------------------------

// The index in paths_ray_queues where this view's queue of a wave begins: that of the view's first pixel, in the half
// for even or for odd waves.
uint queue_begin(uint wave_index) {
    return wave_index % 2u * (paths_ray_queues.at.length() / 2u) + element_index(uvec2(0u), camera.size);
}

// The pixel of an invocation in wave 0. First paths: each pixel of the picture, or with frame_ms those of
// choose_pixels.comp. Further paths: the pixels with a short history. `index`: the pixel's in buffers.
bool find_pixel_of_path(uint sample_index, out uvec2 pixel, out uint index) {
    pixel = INVOCATION_INDEX;  // gl_GlobalInvocationID.xy, or in a ray pipeline gl_LaunchIDEXT.xy
    if (sample_index == 0u && !chooses_pixels()) { return find_pixel(pixel, index); }
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
        return inside && has_path_state(index);
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

#endif
