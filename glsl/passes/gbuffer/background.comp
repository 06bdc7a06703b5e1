// Fills in the pixels that raster left empty.
#version 460
#extension GL_EXT_ray_query : require
#include "passes/gbuffer/pixel.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(at, uniforms.size)) || imageLoad(depth, ivec2(at)).x > 0.0) { return; }
    store_pixel(ivec2(at), resolve_empty_pixel(make_camera_ray(vec2(at) + 0.5)));
}
