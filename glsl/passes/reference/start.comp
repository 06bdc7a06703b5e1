// Starts the paths of a dispatch at the camera.
#version 460
#include "passes/reference/waves.glsl"  // first: it chooses the kind of random numbers
#include "passes/reference/pixel_filter.glsl"

layout(local_size_x = GROUP_SIZE) in;

Walk start_walk(uvec2 pixel, inout uint rng) {
    vec2 position = vec2(pixel) + 0.5 + sample_pixel_filter(rand_vec2f(rng));
    CameraRay ray = make_camera_ray(position);
    if (camera.lens_radius > 0.0) { ray = through_lens(ray, sample_aperture(rand_vec2f(rng))); }
    Walk walk = start_walk(ray);
    walk.cone_width = walk.cone_spread = 0.0;  // for the finest mip level, which the samples average
    if (!is_seen(position)) { walk.throughput = vec3(0.0); }
    CameraRay center = make_camera_ray(vec2(pixel) + 0.5);
    walk.medium = find_medium(center.origin + center.t_min * center.direction);
    return walk;
}

void main() {
    uint index = thread_index(INVOCATION_INDEX), sample_index;
    uvec2 pixel;
    if (!find_path(index, pixel, sample_index)) { return; }
    choose_sample(sample_index);
    WaitingPath waiting;
    waiting.rng = next_rng(pixel, sample_index, 0u, 0u);
    waiting.path = begin_path();
    waiting.path.walk = start_walk(pixel, waiting.rng);
    waiting.walks = true;
    store_path(index, waiting);
    queue_path(index);
}
