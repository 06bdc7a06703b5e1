// Paths that wait for their next ray. They are traced in waves: each is a dispatch over the paths that are left,
// because a subgroup would otherwise wait for the few of its threads with long paths. Laine, Karras and Aila,
// "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/path.glsl"
#include "passes/paths/short_history.glsl"

const uint SPECULAR_ONLY = 0x80000000u;
const uint IS_DIFFUSE = 0x40000000u;  // until the first ray has arrived first_ray_is_diffuse, later diffuse_at_x2
const uint NO_PATH_STATE = 0u;        // flags of a pixel without a path
const float MAX_WAVELENGTH = 1024.0;  // in nanometers

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

void store_path_state(Path path, uint pixel_index) {
    bool is_diffuse = path.bounce == 1u ? path.first_ray_is_diffuse : path.diffuse_at_x2;
    uint flags = path.bounce | path.delta_bounces << 8u | (path.specular_only ? SPECULAR_ONLY : 0u)
        | (is_diffuse ? IS_DIFFUSE : 0u);
    if (SCENE_DISPERSION) { flags |= pack_unorm(path.walk.wavelength / MAX_WAVELENGTH, 14u) << 16u; }
    paths_states.at[pixel_index] = PathState(
        path.rng, flags, apply_first_weight(path, vec3(1.0)), path.walk.throughput, path.walk.direction,
        path.hit.instance, path.hit.triangle, path.hit.barycentrics, path.sum_of_inverse_pdfs, path.footprint,
        path.walk.cone_width, path.walk.medium
    );
}

// A path as store_path_state has left it, but with no light, since what it had found is already in the pixel, and
// without its vertex: `arrive` with `resumed` makes that again from the hit.
Path load_path_state(uint pixel_index) {
    PathState state = paths_states.at[pixel_index];
    Path path = start_path(state.rng);
    path.bounce = state.flags & 0xFFu;
    path.delta_bounces = state.flags >> 8u & 0xFFu;
    path.first_ray_is_diffuse = (state.flags & IS_DIFFUSE) != 0u;
    path.diffuse_at_x2 = path.bounce > 1u && path.first_ray_is_diffuse;
    path.specular_only = (state.flags & SPECULAR_ONLY) != 0u;
    if (SCENE_DISPERSION) { path.walk.wavelength = unpack_unorm(state.flags >> 16u, 14u) * MAX_WAVELENGTH; }
    path.first_weight = state.attenuated_first_weight;
    path.walk.throughput = state.throughput;
    path.walk.direction = state.direction;
    path.walk.delta_path_from_camera = path.bounce == path.delta_bounces;
    // t has been used already, and resolve_surface_interaction finds the side of the surface again.
    path.hit = Hit(0.0, state.instance, state.triangle, state.barycentrics, false);
    path.sum_of_inverse_pdfs = state.sum_of_inverse_pdfs;
    path.footprint = state.footprint;
    path.walk.cone_width = state.cone_width;
    if (SCENE_ABSORPTION) { path.walk.medium = state.medium; }
    return path;
}

// ---- rays that a pass of its own traces ---------------------------------------------------------------

void store_path_rays(Path path, uint pixel_index) {
    LightSample light = path.light_sample;
    paths_rays.at[pixel_index] = PathRays(
        uint(path.has_ray), path.walk.origin, path.walk.mis_pdf, path.receiver.position, path.receiver.normal,
        path.shadow_ray, uvec3(light.light_index, light.part, light.seed)
    );
}

// Of a path that load_path_state has returned.
void load_path_rays(inout Path path, uint pixel_index) {
    PathRays rays = paths_rays.at[pixel_index];
    path.has_ray = rays.has_ray != 0u;
    path.walk.origin = rays.origin;
    path.walk.mis_pdf = rays.mis_pdf;
    path.receiver = Receiver(rays.receiver_position, rays.receiver_normal);
    path.shadow_ray = rays.shadow_ray;
    path.light_sample = LightSample(rays.light_sample.x, rays.light_sample.y, rays.light_sample.z);
}

void store_traced_rays(TracedRays traced, uint pixel_index) {
    Hit hit = traced.segment.hit;
    RayTransmittance passed = traced.segment.transmittance;
    LightAlongRay along_ray = traced.segment.along_ray;
    paths_hits.at[pixel_index] = PathHit(
        traced.visibility, hit.t, hit.instance, hit.triangle, hit.barycentrics,
        vec4(passed.weight, passed.probability), along_ray.radiance, along_ray.radiance_over_probability
    );
}

TracedRays load_traced_rays(uint pixel_index) {
    PathHit found = paths_hits.at[pixel_index];
    // resolve_surface_interaction finds the side of the surface again.
    Hit hit = Hit(found.t, found.instance, found.triangle, found.barycentrics, false);
    Segment segment = Segment(hit, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
    if (SCENE_BLEND) { segment.transmittance = RayTransmittance(found.transmittance.xyz, found.transmittance.w); }
    if (HAS_PASS_THROUGH_LIGHTS) {
        segment.along_ray = LightAlongRay(found.light_along_ray, found.light_along_ray_over_probability);
    }
    return TracedRays(found.visibility, segment);
}

#endif
