// Writes the path tracer's AOVs: the surface that the ray through each pixel's center hits.
#version 460
#include "common/pixel.glsl"
#include "common/random.glsl"
#include "passes/pathtracer/bindings.glsl"
#include "scene/camera.glsl"
#include "scene/surface.glsl"
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
    aov_instance_id.at[index] = hit.instance;
    if (hit.instance == NO_INDEX) {
        aov_depth.at[index] = INFINITY;
        aov_position.at[index] = vec3(0.0);
        aov_geometric_normal.at[index] = vec3(0.0);
        aov_shading_normal.at[index] = vec3(0.0);
        aov_albedo.at[index] = vec3(0.0);
        aov_roughness_metallic.at[index] = vec2(0.0);
        aov_emissive.at[index] = vec3(0.0);
        return;
    }
    SurfaceInteraction surface =
        resolve_surface_interaction(hit, ray.direction, ray.cone_width + ray.cone_spread * hit.t);
    aov_depth.at[index] = hit.t * ray.depth_per_t;
    aov_position.at[index] = surface.world_position;
    aov_geometric_normal.at[index] = surface.geometric_world_normal;
    aov_shading_normal.at[index] = surface.world_normal;
    aov_albedo.at[index] = surface.material.base.color;
    aov_roughness_metallic.at[index] = vec2(surface.material.base.perceptual_roughness, surface.material.base.metallic);
    aov_emissive.at[index] = shown_emission(surface);
}
