// The traced G-buffer: the surface that the ray through each pixel hits, in the same layout as the raster G-buffer.
#version 460
#include "common/pixel.glsl"
#include "passes/gbuffer/pixel.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 at = INVOCATION_INDEX;
    uint index;
    if (!find_pixel(at, index)) { return; }
    CameraRay ray = make_camera_ray(vec2(at) + 0.5);
    uvec2 alpha_seed = pixel_alpha_seed(at);
    Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES, alpha_seed);
    if (hit.instance == NO_INDEX || !is_seen(vec2(at) + 0.5)) {
        store_pixel(at, resolve_empty_pixel(ray));
    } else {
        store_pixel(at, resolve_pixel(ray, hit, meshes.at[instances.at[hit.instance].ray_mesh]));
    }
}
