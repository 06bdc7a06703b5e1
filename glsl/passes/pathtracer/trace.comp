// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera.
#version 460
#define LOW_DISCREPANCY
#include "passes/pathtracer/trace.glsl"
#include "passes/pathtracer/pixel_filter.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

bool start_path(uvec2 pixel, inout Path path, inout Vertex vertex, inout uint rng) {
    vec2 position = vec2(pixel) + 0.5 + sample_pixel_filter(rand_vec2f(rng));
    CameraRay ray = make_camera_ray(position);
    if (camera.lens_radius > 0.0) { ray = through_lens(ray, sample_disk(rand_vec2f(rng))); }
    path.walk = start_walk(ray);
    path.walk.cone_width = path.walk.cone_spread = 0.0;  // the finest level of textures: samples average it
    if (!is_seen(position)) { path.walk.throughput = vec3(0.0); }
    return false;
}

void main() { trace_paths(); }
