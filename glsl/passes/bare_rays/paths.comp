// Traces paths without shading: closest-hit rays that scatter around the geometric normal, nothing else. The baseline
// of all passes that trace.
#version 460
#include "common/pixel.glsl"
#include "common/random.glsl"
#include "passes/reference/bindings.glsl"
#include "scene/camera.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint rng = seed_rng(pixel, path_sampling.sample_index, path_sampling.seed);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    uint rays = 0u;
    while (true) {
        rays += 1u;
        Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_BOTH_FACES);
        if (hit.instance == NO_INDEX || rays > path_sampling.max_bounces) { break; }
        Instance instance = instances.at[hit.instance];
        TrianglePoint point = resolve_triangle(instance, meshes.at[instance.ray_mesh], hit.triangle, hit.barycentrics);
        vec3 normal = faceforward(point.geometric_world_normal, ray.direction, point.geometric_world_normal);
        ray.origin = point.world_position + normal * point.ray_offset;
        ray.direction = orthonormalize(normal) * sample_cosine_hemisphere(rand_vec2f(rng));
        ray.t_min = 0.0;
    }
    ray_count.at[pixel_index(pixel, camera.size)] = rays;
}
