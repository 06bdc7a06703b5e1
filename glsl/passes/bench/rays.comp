// A bare ray-query kernel, what the path tracer's speed is measured against: camera rays, then from every hit a ray in a
// uniform direction on its side, with as little work between as there can be.
#version 460
#extension GL_EXT_ray_query : require
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/pathtracer/camera.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(set = 1, binding = 14, scalar) buffer BenchRaysBlock { uint at[]; } bench_rays;  // traced by the pixel

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    uint rng = seed_rng(pixel, uniforms.sample_index, uniforms.seed);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    uint traced = 0u;
    float t_min = ray.t_min;
    while (traced <= uniforms.max_bounces) {
        Hit hit = trace_closest_hit(ray.origin, t_min, ray.direction, INFINITY, TRACE_BOTH_FACES);
        traced += 1u;
        if (hit.instance == NO_INDEX) { break; }
        ray.origin += ray.direction * (hit.t * 0.9999);
        vec3 direction = sample_uniform_hemisphere(rand_vec2f(rng));
        ray.direction = dot(direction, ray.direction) < 0.0 ? direction : -direction;
        t_min = 0.0;
    }
    bench_rays.at[pixel.y * uniforms.size.x + pixel.x] = traced;
}
