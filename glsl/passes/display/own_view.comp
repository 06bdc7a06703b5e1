// Draws an output of a stage of the user's own over the picture: gray for one number, colors for two and more, and a
// color for each integer. solari_vk/renderers/own_stages.py declares the output in a header.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "common/hash.glsl"
#include "common/pixel.glsl"
#include "passes/display/bindings.glsl"

#ifndef OWN_COLOR
#define OWN_SIZE camera.picture_size
#define OWN_COLOR(at) vec3(0.0)
#endif

layout(local_size_x = 8, local_size_y = 8) in;

// As debug views show numbers.
vec3 show_number(uint number) { return 0.2 + 0.8 * unpackUnorm4x8(pcg(number)).rgb; }

void main() {
    uvec2 size = uvec2(imageSize(display)), pixel = gl_GlobalInvocationID.xy;
    if (!is_inside(pixel, size)) { return; }
    uvec2 at = pixel * OWN_SIZE / size;
    imageStore(display, ivec2(pixel), vec4(OWN_COLOR(at), 1.0));
}
