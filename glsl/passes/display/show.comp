// Shows radiance: exposure, tone mapping and sRGB.
#version 460
#include "common/pixel.glsl"
#include "passes/display/bindings.glsl"
#include "passes/display/tonemap.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(display);
    if (!is_inside(pixel, size)) { return; }
    imageStore(display, pixel, vec4(show_radiance(radiance.at[pixel.y * size.x + pixel.x]), 1.0));
}
