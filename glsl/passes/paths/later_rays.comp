// The next ray of each path that waits; in the last wave all rays that are left.
#version 460
#include "generated/passes/paths.glsl"  // LAST_WAVE, written by solari_vk/passes/paths.py
#include "passes/paths/pixel.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = unpack_path(load_path_state(index));
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;

    // The first call of `arrive` only makes the vertex again. It is in the loop, since drivers inline each call.
    bool resumed = true, goes_on = true;
    do {
        if (!resumed) {
            choose_rays(path);
            goes_on = add_rays(path, trace_rays(path));
        }
        goes_on = goes_on && arrive(path, resumed);
        if (!resumed && paths_wave.index < LAST_WAVE) { break; }
        resumed = false;
    } while (goes_on);
    if (goes_on) {
        store_path_state(path, index);
        queue_path(index, paths_wave.index + 1u);
    }
    GBufferSurface surface = load_gbuffer(pixel);
    add_to_pixel(path, later_light(path, index, surface.material.base.perceptual_roughness), surface, index);
}
