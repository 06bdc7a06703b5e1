// Writes the path tracer's AOVs: the surface that the ray through each pixel's center hits.
#version 460
#include "common/pixel.glsl"
#include "common/random.glsl"
#include "passes/reference/aov.glsl"
#include "scene/camera.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    if (!is_inside(pixel, camera.size) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }
    uint index = pixel_index(pixel, camera.size);

    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    uint rng = seed_rng(pixel, floatBitsToUint(camera.jitter.x), floatBitsToUint(camera.jitter.y));
    uvec2 alpha_seed = random_alpha_seed(rng);
    Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES, alpha_seed);
    bool misses = hit.instance == NO_INDEX || !is_seen(vec2(pixel) + 0.5);
    if (has_motion) {
        aov_motion_vectors.at[index] = misses ? background_motion_vector(ray)
            : hit_motion_vector(hit, meshes.at[instances.at[hit.instance].ray_mesh]);
    } else if (misses) {
        store_empty_aovs(index);
    } else {
        store_aovs(index, ray, hit, meshes.at[instances.at[hit.instance].ray_mesh]);
    }
}
