// Starts a path of each pixel at the surface that the pixel shows: next event estimation and the first ray.
#version 460
#include "common/pixel.glsl"
#include "common/sobol.glsl"
#include "passes/bindings.glsl"  // and passes/views.glsl: find_pixel, choose_view, element_index
#include "passes/paths/pixel.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Whether trace.comp traces the rays that are chosen here, and arrive.comp goes on.
layout(constant_id = traces_apart_id) const bool traces_apart = false;

const uint PASS_SALT = 0x3F84D5B5u, SAMPLE_SALT = 0x9E3779B9u;

// Over consecutive frames a pixel's first directions are points of a Sobol sequence, so that the mean of frames has
// less noise than with independent ones. Each further path of the frame has a sequence of its own, except for the
// number that chooses the lobe: over the paths of a frame that is a shifted van der Corput sequence. number: as of
// samples_per_pixel.
Path start_path(uvec2 pixel, GBufferSurface surface, uint sample_index, uint number) {
    uint first_salt = this_frame.seed ^ PASS_SALT, salt = first_salt ^ sample_index * SAMPLE_SALT;
    Path path = start_path(seed_rng(pixel, this_frame.index, salt));
    if (SCENE_DISPERSION) {
        float u = fract(wavelength_u(pixel) + unit_float(bitfieldReverse(sample_index)));
        disperse(path.walk, surface.instance, surface.material, u);
    }
    path.vertex = make_vertex(surface);
    path.walk.medium = path.vertex.above;
    float choice = sobol_point(number, seed_rng(pixel, 0u, first_salt)).x;
    path.lobe_u = fract(choice + unit_float(bitfieldReverse(sample_index)));
    uint sequence = seed_rng(pixel, 0u, salt);
    // + 1: for the first path `sequence` is the seed of `choice`, whose numbers `u` would repeat
    path.u = sobol_point(number, sequence + 1u);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    path.walk.cone_spread = ray.cone_spread;
    path.walk.cone_width = ray.cone_width + ray.cone_spread * distance(surface.world_position, ray.origin);
    return path;
}

void main() {
    uint sample_index = paths_wave.sample_index, index;
    uvec2 pixel;
    if (!find_pixel_of_path(sample_index, pixel, index)) { return; }
    if (traces_apart) { store_no_path_state(index); }
    uint number, samples = samples_per_pixel(index, number);
    if (max_timed_samples > 0u && sample_index >= samples) { return; }
    if (sample_index == 0u && samples > 1u) {
        uint thread = atomicAdd(paths_queues.at[view_index].short_history_count, 1u);
        paths_short_histories.at[element_index(uvec2(0u), camera.size) + thread] = index;
    }
    GBufferSurface surface = load_gbuffer(pixel);
    if (!surface.exists) {
        paths_diffuse.at[index] = paths_specular.at[index] = vec4(0.0);
        return;
    }
    Path path = start_path(pixel, surface, sample_index, number);
    choose_rays(path);
    bool waits = traces_apart;
    if (traces_apart) {
        store_path_rays(path, index);
    } else {
        waits = add_rays(path, trace_rays(path)) && arrive(path, false);
        surface = load_gbuffer(pixel);  // loaded again, instead of kept in registers across rays
        PerLobe light = first_light(path, index, surface.material.base.perceptual_roughness);
        add_to_pixel(path, light, surface, index);
        if (waits) { queue_path(index, 1u); }
    }
    if (waits) { store_path_state(path, index); }
}
