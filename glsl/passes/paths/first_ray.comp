// Starts a path of each pixel at the surface that the pixel shows: next event estimation and the first ray.
#version 460
#include "common/pixel.glsl"
#include "common/sobol.glsl"
#include "passes/bindings.glsl"  // and passes/views.glsl: find_pixel, choose_view, element_index
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/demodulation.glsl"
#include "passes/paths/candidate.glsl"
#include "passes/paths/path_state.glsl"
#include "passes/paths/short_history.glsl"
#include "scene/trace.glsl"  // INVOCATION_INDEX, INVOCATION_LAYER

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x3F84D5B5u, SAMPLE_SALT = 0x9E3779B9u;

// Over consecutive frames a pixel's first directions are points of a Sobol sequence, so that the mean of frames has
// less noise than with independent ones. Each further path of the frame has a sequence of its own, except for the
// number that chooses the lobe: over the paths of a frame that is a shifted van der Corput sequence.
Path start_path(uvec2 pixel, GBufferSurface surface, uint sample_index) {
    uint first_salt = this_frame.seed ^ PASS_SALT, salt = first_salt ^ sample_index * SAMPLE_SALT;
    Path path = start_path(seed_rng(pixel, this_frame.index, salt));
    if (SCENE_DISPERSION) {
        float u = fract(wavelength_u(pixel) + unit_float(bitfieldReverse(sample_index)));
        disperse(path.walk, surface.instance, surface.material, u);
    }
    path.vertex = make_vertex(surface);
    path.walk.medium = path.vertex.above;
    float choice = sobol_point(this_frame.index, seed_rng(pixel, 0u, first_salt)).x;
    path.lobe_u = fract(choice + unit_float(bitfieldReverse(sample_index)));
    uint sequence = seed_rng(pixel, 0u, salt);
    // + 1: for the first path `sequence` is the seed of `choice`, whose numbers `u` would repeat
    path.u = sobol_point(this_frame.index, sequence + 1u);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    path.walk.cone_spread = ray.cone_spread;
    path.walk.cone_width = ray.cone_width + ray.cone_spread * distance(surface.world_position, ray.origin);
    return path;
}

// The pixel of an invocation. First paths: each pixel of the picture, or with frame_ms those of choose_pixels.comp.
// Further paths: the pixels with a short history. `index`: the pixel's in buffers.
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

void main() {
    uint sample_index = paths_wave.sample_index, index;
    uvec2 pixel;
    if (!find_pixel_of_path(sample_index, pixel, index)) { return; }
    uint samples = samples_per_pixel(index);
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
    Path path = start_path(pixel, surface, sample_index);
    bool goes_on = advance(path);
    surface = load_gbuffer(pixel);  // loaded again, instead of kept in registers across rays
    PerLobe light = path_light(path);
    // With restir a pixel takes one path.
    if (paths_reuse) { light = write_candidate(path, index, surface.material.base.perceptual_roughness); }
    if (goes_on) { store_path_state(path, index, 1u); }
    Demodulation albedo = demodulation(surface);
    vec2 distances = path.first_ray_is_diffuse ? vec2(path.hit.t, 0.0) : vec2(0.0, path.hit.t);
    vec4 diffuse = vec4(light.diffuse / albedo.diffuse / float(samples), distances.x);
    vec4 specular = vec4(light.specular / albedo.specular / float(samples), distances.y);
    if (sample_index > 0u) {
        vec4 sum_diffuse = paths_diffuse.at[index], sum_specular = paths_specular.at[index];
        diffuse = vec4(sum_diffuse.rgb + diffuse.rgb, sum_diffuse.w > 0.0 ? sum_diffuse.w : diffuse.w);
        specular = vec4(sum_specular.rgb + specular.rgb, sum_specular.w > 0.0 ? sum_specular.w : specular.w);
    }
    paths_diffuse.at[index] = diffuse;
    paths_specular.at[index] = specular;
}
