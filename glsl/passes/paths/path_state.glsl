// Paths that wait for their next rays. They are traced in waves: each is a dispatch over the paths that are left, because
// a subgroup would otherwise wait for the few of its threads with long paths. Laine, Karras and Aila, "Megakernels
// Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/path.glsl"
#include "passes/paths/short_history.glsl"

const uint HAS_RAY = 0x80000000u;
const uint IS_DIFFUSE = 0x40000000u;  // until the first ray has arrived first_ray_is_diffuse, later diffuse_at_x2
const float MAX_WAVELENGTH = 1024.0;  // in nanometers

// The index in paths_ray_queues where this view's queue of a wave begins: that of the view's first pixel, in the half
// for even or for odd waves.
uint queue_begin(uint wave_index) {
    return wave_index % 2u * (paths_ray_queues.at.length() / 2u) + element_index(uvec2(0u), camera.size);
}

// The pixel of an invocation in waves 0 and 1, which begin paths and trace their first rays. First paths: each pixel of
// the picture, or with frame_ms those of choose_pixels.comp. Further paths: the pixels with a short history. `index`:
// the pixel's in buffers.
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

// The pixel of the path whose rays an invocation traces. Returns whether there is one.
bool find_waiting_path(out uvec2 pixel, out uint index) {
    if (paths_wave.index == 1u) {
        return find_pixel_of_path(paths_wave.sample_index, pixel, index) && paths_states.at[index].flags != 0u;
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

// Of a path that has chosen its next rays.
void store_path_state(Path path, uint pixel_index) {
    bool is_diffuse = path.bounce == 1u ? path.first_ray_is_diffuse : path.diffuse_at_x2;
    uint flags = path.bounce | path.delta_bounces << 8u | (path.has_ray ? HAS_RAY : 0u)
        | (is_diffuse ? IS_DIFFUSE : 0u);
    if (SCENE_DISPERSION) { flags |= pack_unorm(path.walk.wavelength / MAX_WAVELENGTH, 14u) << 16u; }
    LightSample light = path.light_sample;
    paths_states.at[pixel_index] = PathState(
        path.rng, flags, apply_first_weight(path, vec3(1.0)), path.walk.throughput, path.walk.origin,
        path.walk.direction, path.walk.mis_pdf, path.receiver.position, path.receiver.normal,
        path.sum_of_inverse_pdfs, path.footprint, path.walk.cone_width, path.walk.medium, path.shadow_ray,
        uvec3(light.light_index, light.part, light.seed)
    );
}

// A path as store_path_state has left it, without its vertex, and with no light, since what it had found is already in
// the pixel.
Path load_path_state(uint pixel_index) {
    PathState state = paths_states.at[pixel_index];
    Path path = start_path(state.rng);
    path.bounce = state.flags & 0xFFu;
    path.delta_bounces = state.flags >> 8u & 0xFFu;
    path.has_ray = (state.flags & HAS_RAY) != 0u;
    path.first_ray_is_diffuse = (state.flags & IS_DIFFUSE) != 0u;
    path.diffuse_at_x2 = path.bounce > 1u && path.first_ray_is_diffuse;
    if (SCENE_DISPERSION) { path.walk.wavelength = unpack_unorm(state.flags >> 16u, 14u) * MAX_WAVELENGTH; }
    path.first_weight = state.attenuated_first_weight;
    path.walk.throughput = state.throughput;
    path.walk.origin = state.origin;
    path.walk.direction = state.direction;
    path.walk.mis_pdf = state.mis_pdf;
    path.walk.delta_path_from_camera = path.bounce == path.delta_bounces;
    path.receiver = Receiver(state.receiver_position, state.receiver_normal);
    path.sum_of_inverse_pdfs = state.sum_of_inverse_pdfs;
    path.footprint = state.footprint;
    path.walk.cone_width = state.cone_width;
    if (SCENE_ABSORPTION) { path.walk.medium = state.medium; }
    path.shadow_ray = state.shadow_ray;
    path.light_sample = LightSample(state.light_sample.x, state.light_sample.y, state.light_sample.z);
    return path;
}

// ---- rays that a pass of its own traces ---------------------------------------------------------------

void store_traced_rays(TracedRays traced, uint rng, uint pixel_index) {
    Hit hit = traced.segment.hit;
    RayTransmittance passed = traced.segment.transmittance;
    LightAlongRay along_ray = traced.segment.along_ray;
    paths_traced.at[pixel_index] = TracedState(
        rng, traced.visibility, hit.t, hit.instance, hit.triangle, hit.barycentrics,
        vec4(passed.weight, passed.probability), along_ray.radiance, along_ray.radiance_over_probability
    );
}

TracedRays load_traced_rays(uint pixel_index, out uint rng) {
    TracedState state = paths_traced.at[pixel_index];
    rng = state.rng;
    // resolve_surface_interaction finds the side of the surface again
    Hit hit = Hit(state.t, state.instance, state.triangle, state.barycentrics, false);
    Segment segment = Segment(hit, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
    if (SCENE_BLEND) { segment.transmittance = RayTransmittance(state.transmittance.xyz, state.transmittance.w); }
    if (HAS_PASS_THROUGH_LIGHTS) {
        segment.along_ray = LightAlongRay(state.light_along_ray, state.light_along_ray_over_probability);
    }
    return TracedRays(state.visibility, segment);
}

#endif
