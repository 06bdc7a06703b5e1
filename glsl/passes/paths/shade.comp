// Adds the light that the rays of each waiting path find, moves the path to the next vertex, and chooses the rays that
// leave it. In the last wave, all rays that are left.
#version 460
#include "generated/passes/paths.glsl"  // LAST_WAVE, written by solari_vk/passes/paths.py
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/demodulation.glsl"
#include "passes/paths/candidate.glsl"
#include "passes/paths/path_state.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Whether trace.comp has traced the rays with which paths wait; and whether this wave isn't the last, so that this shader
// then traces none itself.
layout(constant_id = rays_are_traced_id) const bool rays_are_traced = false;
layout(constant_id = traces_none_id) const bool traces_none = false;

// The light that the path adds to its pixel now, where reservoirs don't get it.
PerLobe light_for_pixel(inout Path path, uint index, float perceptual_roughness) {
    if (!paths_reuse) { return path_light(path); }
    if (path.bounce == 1u) { return write_candidate(path, index, perceptual_roughness); }
    PerLobe light = path_light(path);
    paths_reservoir_candidates.at[index].radiance += path.reusable_radiance;
    // 0 only for a delta lobe (write_candidate), since the first ray has hit a surface
    bool delta = paths_reservoir_candidates.at[index].path_contribution_weight == 0.0;
    if (delta || !reuses_specular(perceptual_roughness)) {
        light.specular += apply_first_weight(path, path.reusable_radiance).specular;
    }
    return light;
}

// Moves the light that the path has found to its pixel.
void add_to_pixel(inout Path path, uvec2 pixel, uint index) {
    bool first = path.bounce == 1u;
    if (!first && path.radiance + path.reusable_radiance == vec3(0.0)) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    PerLobe light = light_for_pixel(path, index, surface.material.base.perceptual_roughness);
    Demodulation albedo = demodulation(surface);
    float share = 1.0 / float(samples_per_pixel(index));
    vec4 diffuse = paths_diffuse.at[index], specular = paths_specular.at[index];
    diffuse.rgb += share * light.diffuse / albedo.diffuse;
    specular.rgb += share * light.specular / albedo.specular;
    if (first && path.first_ray_is_diffuse && !(diffuse.w > 0.0)) { diffuse.w = path.hit.t; }
    if (first && !path.first_ray_is_diffuse && !(specular.w > 0.0)) { specular.w = path.hit.t; }
    paths_diffuse.at[index] = diffuse;
    paths_specular.at[index] = specular;
    path.direct = ZERO_LOBES;
    path.first_along_ray = NO_LIGHT_ALONG_RAY;
    path.radiance = path.reusable_radiance = vec3(0.0);
}

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = load_path_state(index);
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;

    bool are_traced = rays_are_traced, goes_on;
    do {
        TracedRays traced;
        if (traces_none || are_traced) {
            traced = load_traced_rays(index, path.rng);
        } else {
            traced = trace_rays(path);
        }
        are_traced = false;
        goes_on = add_rays(path, traced) && arrive(path);
        add_to_pixel(path, pixel, index);
        if (goes_on) { choose_rays(path); }
        goes_on = goes_on && is_waiting(path);
    } while (goes_on && !traces_none && paths_wave.index == LAST_WAVE);
    if (goes_on) {
        store_path_state(path, index);
        queue_path(index, paths_wave.index + 1u);
    }
}
