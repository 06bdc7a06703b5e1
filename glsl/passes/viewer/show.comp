// The reference path tracer's picture, as passes/display/show.comp shows the realtime one.
#version 460
#include "passes/bindings.glsl"
#include "passes/display/tonemap.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    vec3 radiance = radiance_mean.at[pixel.y * uniforms.size.x + pixel.x];
    imageStore(display, ivec2(pixel), vec4(show_radiance(radiance), 1.0));
}
