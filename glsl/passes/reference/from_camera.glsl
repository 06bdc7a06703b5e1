// The path tracer's loop with paths that start at the camera.
#ifndef PASSES_REFERENCE_FROM_CAMERA_GLSL
#define PASSES_REFERENCE_FROM_CAMERA_GLSL

#include "passes/reference/pixel_filter.glsl"
#include "passes/reference/trace.glsl"

bool start_path(uvec2 pixel, inout Path path, inout Vertex vertex, inout uint rng) {
    vec2 position = vec2(pixel) + 0.5 + sample_pixel_filter(rand_vec2f(rng));
    CameraRay ray = make_camera_ray(position);
    if (camera.lens_radius > 0.0) { ray = through_lens(ray, sample_aperture(rand_vec2f(rng))); }
    path.walk = start_walk(ray);
    path.walk.cone_width = path.walk.cone_spread = 0.0;  // for the finest mip level, which the samples average
    if (!is_seen(position)) { path.walk.throughput = vec3(0.0); }
    return false;
}

vec3 start_position(uvec2 pixel) {
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    return ray.origin + ray.t_min * ray.direction;
}

#endif
