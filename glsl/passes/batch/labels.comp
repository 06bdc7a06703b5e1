// First hits of many views: the surface that the ray through each pixel's center hits, with the values of
// reference/aov.comp, the user's number of its triangle, and its motion.
#version 460
#define MANY_VIEWS
#include "common/random.glsl"
#include "passes/reference/aov.glsl"
#include "passes/views.glsl"
#include "scene/camera.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
// What takes time of its own is computed where it is asked for.
layout(constant_id = has_materials_id) const bool has_materials = false;

layout(set = 1, scalar) writeonly buffer AovPrimitiveBlock { uint at[]; } aov_primitive;  // NO_INDEX: nothing
// The user's number of each triangle in the device's order, and the index of each mesh's first triangle in it.
layout(set = 1, scalar) readonly buffer TriangleOrdersBlock { uint at[]; } triangle_orders;
layout(set = 1, scalar) readonly buffer OrderStartsBlock { uint at[]; } order_starts;

void store_geometry(uint index, CameraRay ray, Hit hit, Mesh mesh) {
    TrianglePoint point = resolve_triangle(instances.at[hit.instance], mesh, hit.triangle, hit.barycentrics);
    point.world_position = position_on_ray(
        point.world_position, point.geometric_world_normal, point.extent, ray.origin, hit.t * ray.direction
    );
    bool front_face = dot(ray.direction, point.geometric_world_normal) <= 0.0;
    STORE_GEOMETRY(index)
}

void store_empty_geometry(uint index) {
    STORE_NO_GEOMETRY(index)
}

void main() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    uint index;
    if (!find_pixel(pixel, index) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }

    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    uint rng = seed_rng(pixel, floatBitsToUint(camera.jitter.x), floatBitsToUint(camera.jitter.y));
    uvec2 alpha_seed = random_alpha_seed(rng);
    Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES, alpha_seed);
    if (hit.instance == NO_INDEX || !is_seen(vec2(pixel) + 0.5)) {
        if (has_materials) { store_empty_aovs(index); } else { store_empty_geometry(index); }
        aov_primitive.at[index] = NO_INDEX;
        if (has_motion) { aov_motion_vectors.at[index] = background_motion_vector(ray); }
        return;
    }
    Instance instance = instances.at[hit.instance];
    Mesh mesh = meshes.at[instance.ray_mesh];
    if (has_materials) { store_aovs(index, ray, hit, mesh); } else { store_geometry(index, ray, hit, mesh); }
    aov_primitive.at[index] = triangle_orders.at[order_starts.at[instance.ray_mesh] + hit.triangle];
    if (has_motion) { aov_motion_vectors.at[index] = hit_motion_vector(hit, mesh); }
}
