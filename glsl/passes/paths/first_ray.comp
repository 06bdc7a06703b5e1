// One path a pixel, from the surface that the pixel shows: its light sample and its first ray.
#version 460
#include "common/sobol.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/demodulation.glsl"
#include "passes/paths/offer.glsl"
#include "passes/paths/waiting.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x3F84D5B5u;

// Over consecutive frames a pixel's first directions are points of a Sobol sequence, so that the mean of frames has
// less noise than with independent ones.
Path start_path(uvec2 pixel, GBufferSurface surface) {
    Path path = start_path(seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT));
    path.vertex = make_vertex(surface);
    path.medium_below = find_medium_below(surface.instance, surface.material);
    uint sequence = seed_rng(pixel, 0u, this_frame.seed ^ PASS_SALT);
    path.choice = sobol_point(this_frame.index, sequence).x;
    path.u = sobol_point(this_frame.index, sequence + 1u);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    path.cone_spread = ray.cone_spread;
    path.cone_width = ray.cone_width + ray.cone_spread * distance(surface.world_position, ray.origin);
    return path;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    uint index = pixel.y * camera.size.x + pixel.x;
    GBufferSurface surface = load_gbuffer(pixel);
    if (!surface.exists) {
        paths_diffuse.at[index] = paths_specular.at[index] = vec4(0.0);
        return;
    }
    Path path = start_path(pixel, surface);
    bool goes_on = advance(path);
    surface = load_gbuffer(pixel);  // again, instead of kept across rays
    Lobes light = path_light(path);
    if (paths_reuse) { light = offer_light(path, index, surface.material.perceptual_roughness); }
    if (goes_on) { wait(path, index, 1u); }
    Demodulation by = demodulation(surface);
    vec2 distances = path.diffuse_first ? vec2(path.hit.t, 0.0) : vec2(0.0, path.hit.t);
    paths_diffuse.at[index] = vec4(light.diffuse / by.diffuse, distances.x);
    paths_specular.at[index] = vec4(light.specular / by.specular, distances.y);
}
