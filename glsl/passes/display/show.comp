// Shows the frame: radiance after exposure and tone mapping, or the debug view of uniforms.view.
#version 460
#include "passes/bindings.glsl"
#include "passes/display/views.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    imageStore(display, ivec2(pixel), vec4(show_view(pixel), 1.0));
}
