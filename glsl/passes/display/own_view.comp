// Draws an output of a stage of the user's own over the picture: gray for one number, colors for two and more, and a
// color for each integer. solari_vk/renderers/own_stages.py declares the output in a header, with functions for its
// size and for what a pixel has.
#version 460
#extension GL_EXT_scalar_block_layout : require

// The output may have any name: functions of its header read it, and these functions have other names here.
#define is_inside own_view_is_inside
#define pixel_index own_view_pixel_index
#define pcg own_view_pcg
#define pcg4d own_view_pcg4d
#define seed_rng own_view_seed_rng
#define unit_float own_view_unit_float
#include "common/hash.glsl"
#include "common/pixel.glsl"
#include "passes/display/bindings.glsl"

#ifndef OWN_VIEW
uvec2 own_view_size() { return uvec2(1u); }
vec3 own_view_value(uvec2 pixel) { return vec3(0.0); }
#endif

layout(local_size_x = 8, local_size_y = 8) in;

// Colors as they are, and numbers as debug views show them.
vec3 own_view_color(vec3 color) { return color; }
vec3 own_view_color(uint number) { return 0.2 + 0.8 * unpackUnorm4x8(pcg(number)).rgb; }

void main() {
    uvec2 size = uvec2(imageSize(display)), pixel = gl_GlobalInvocationID.xy;
    if (!is_inside(pixel, size)) { return; }
    vec3 color = own_view_color(own_view_value(pixel * own_view_size() / size));
    imageStore(display, ivec2(pixel), vec4(color, 1.0));
}
