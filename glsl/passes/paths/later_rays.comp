// The next ray of each path that waits; in the last wave all rays that are left.
#version 460
#include "generated/passes/paths.glsl"  // LAST_WAVE, written by solari_vk/passes/paths.py
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/demodulation.glsl"
#include "passes/paths/reservoir.glsl"
#include "passes/paths/path_state.glsl"  // and passes/rows.glsl: thread_index, GROUP_SIZE
#include "passes/paths/short_history.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    choose_view(INVOCATION_LAYER);
    uint queue_index = thread_index(INVOCATION_INDEX);
    if (queue_index >= paths_queues.at[view_index].count) { return; }
    uint index = paths_ray_queues.at[queue_begin(paths_wave.index) + queue_index];
    uvec2 pixel = find_pixel_of(index);
    Path path = load_path_state(index);
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;

    // The first call of `arrive` only makes the vertex again. It is in the loop, since drivers inline each call.
    bool resumed = true, goes_on = true;
    do {
        goes_on = (resumed || trace_next_ray(path)) && arrive(path, resumed);
        if (!resumed && paths_wave.index != LAST_WAVE) { break; }
        resumed = false;
    } while (goes_on);
    if (goes_on) { store_path_state(path, index, paths_wave.index + 1u); }

    GBufferSurface surface = load_gbuffer(pixel);
    PerLobe light = path_light(path);
    if (paths_reuse) {
        paths_reservoir_candidates.at[index].radiance += path.reusable_radiance;
        // 0 only for a delta lobe (write_candidate), since the first ray has hit a surface
        bool delta = paths_reservoir_candidates.at[index].path_contribution_weight == 0.0;
        if (delta || !reuses_specular(surface.material.base.perceptual_roughness)) {
            light.specular += apply_first_weight(path, path.reusable_radiance).specular;
        }
    }
    Demodulation albedo = demodulation(surface);
    float share = 1.0 / float(samples_per_pixel(index));
    paths_diffuse.at[index].rgb += share * light.diffuse / albedo.diffuse;
    paths_specular.at[index].rgb += share * light.specular / albedo.specular;
}
