// The G-buffer by rays: what the ray through every pixel meets, in the layout that raster writes.
#version 460
#extension GL_EXT_ray_query : require
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/pathtracer/camera.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    ivec2 at = ivec2(pixel);

    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES);
    if (hit.instance == NO_INDEX) {
        imageStore(depth, at, vec4(0.0));
        imageStore(gbuffer, at, uvec4(0u));
        imageStore(gbuffer_surface, at, uvec4(0u, NO_INDEX, 0u, 0u));
        // what is infinitely far moves with the camera's turn alone
        vec3 far = uniforms.world_from_view[3] + ray.direction * 1e6;
        vec3 previous_far = uniforms.previous_world_from_view[3] + ray.direction * 1e6;
        imageStore(motion_vectors, at, vec4(motion_vector(far, previous_far), 0.0, 0.0));
        return;
    }

    ResolvedRayHitFull surface = resolve_ray_hit_full(hit, ray.direction, ray.cone_spread * hit.t);
    vec3 emissive = surface.emits ? surface.material.emissive : vec3(0.0);
    imageStore(depth, at, vec4(uniforms.near / (hit.t * ray.depth_per_t)));
    imageStore(gbuffer, at, pack_gbuffer(surface.material, emissive, surface.world_normal));
    imageStore(gbuffer_surface, at, uvec4(pack_octahedral_2x16(surface.geometric_world_normal), hit.instance, 0u, 0u));

    Instance instance = instances.at[hit.instance];
    Mesh mesh = meshes.at[instance.ray_mesh];
    uvec3 corners = mesh.triangles.at[hit.triangle];
    vec3 object_position = (1.0 - hit.barycentrics.x - hit.barycentrics.y) * mesh.positions.at[corners.x]
        + hit.barycentrics.x * mesh.positions.at[corners.y] + hit.barycentrics.y * mesh.positions.at[corners.z];
    vec3 before = previous_world_position(hit.instance, object_position, surface.world_position);
    imageStore(motion_vectors, at, vec4(motion_vector(surface.world_position, before), 0.0, 0.0));
}
