// Adds the light that the rays of trace.comp have found, and moves each path to the surface that its ray has hit.
#version 460
#include "passes/paths/pixel.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = load_path_with_rays(index);
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;
    TracedRays traced = load_path_hit(index, path.rng);
    bool goes_on = add_rays(path, traced) && arrive(path, false);
    GBufferSurface surface = load_gbuffer(pixel);
    float roughness = surface.material.base.perceptual_roughness;
    bool first = path.bounce == 1u;
    PerLobe light = first ? first_light(path, index, roughness) : later_light(path, index, roughness);
    add_to_pixel(path, light, surface, index);
    if (goes_on) {
        store_path_state(path, index);
        queue_path(index, paths_wave.index + 1u);
    }
}
