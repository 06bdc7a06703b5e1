#version 460
#extension GL_EXT_ray_query : require
#include "common/random.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "scene/trace.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
layout(set = 1, binding = 149, scalar) buffer BlockedBlock { uint at[]; } blocked;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    uint rng = seed_rng(pixel, 0u, 1u), count = 0u;
    for (uint i = 0u; surface.exists && i < 32u; i++) {
        vec3 direction = orthonormalize(surface.geometric_world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
        vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
        count += uint(!trace_visibility(origin, direction, INFINITY));
    }
    blocked.at[pixel.y * camera.size.x + pixel.x] = count;
}
