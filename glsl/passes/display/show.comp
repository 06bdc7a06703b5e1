// Shows radiance: exposure, tone mapping and sRGB.
#version 460
#include "passes/bindings.glsl"
#include "passes/display/tonemap.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    uint index = pixel.y * uniforms.size.x + pixel.x;
    imageStore(display, ivec2(pixel), vec4(show_radiance(radiance.at[index]), 1.0));
}
