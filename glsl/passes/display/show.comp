// Shows radiance: exposure, tone mapping and sRGB.
#version 460
#include "passes/display/bindings.glsl"
#include "passes/display/tonemap.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

#ifdef MANY_VIEWS
#define PICTURE_SIZE camera.picture_size
#else
#define PICTURE_SIZE uvec2(imageSize(display))
#endif

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (!find_element(pixel, PICTURE_SIZE, index)) { return; }
    imageStore(display, ivec2(gl_GlobalInvocationID.xy), vec4(show_radiance(radiance.at[index]), 1.0));
}
