// Paths that start at the camera. Random numbers are of low-discrepancy sequences over samples: common/random.glsl.
#ifndef PASSES_REFERENCE_FROM_CAMERA_GLSL
#define PASSES_REFERENCE_FROM_CAMERA_GLSL

#extension GL_EXT_scalar_block_layout : require
#define LOW_DISCREPANCY
#include "passes/reference/path.glsl"
#include "passes/reference/pixel_filter.glsl"

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

// Adaptive sampling, planned by solari_vk/output/adaptive.py: the numbers of samples before and after a pass, for each
// half of a block of 8x8 pixels, which is divided like a checkerboard. The number of a half depends on the error of the
// other half and of other blocks, since a mean is biased if its own samples decide when it stops. With many views
// sampling isn't adaptive.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

uvec2 sample_range(uvec2 pixel) {
#ifdef MANY_VIEWS
    return uniform_sample_range();
#else
    if (path_sampling.has_sample_ranges == 0u) { return uniform_sample_range(); }
    uint block = pixel.y / 8u * ((camera.size.x + 7u) / 8u) + pixel.x / 8u;
    uvec2 range = sample_ranges.at[2u * block + (pixel.x + pixel.y) % 2u];
    uvec2 this_dispatch = range.x + uniform_sample_range();  // counted from the first sample of the range
    return min(this_dispatch, range.y);
#endif
}

#endif
