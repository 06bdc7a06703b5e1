// Draws the debug view display_settings.debug_view over the picture; 0 leaves the picture as it is.
#ifndef PASSES_DISPLAY_DEBUG_VIEW_GLSL
#define PASSES_DISPLAY_DEBUG_VIEW_GLSL

#include "passes/display/bindings.glsl"
#include "passes/display/debug_views.glsl"
#include "generated/passes/debug_views.glsl"  // show_debug_view

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (display_settings.debug_view == 0u || any(greaterThanEqual(pixel, camera.size))) { return; }
    imageStore(display, ivec2(pixel), vec4(show_debug_view(display_settings.debug_view, pixel), 1.0));
}

#endif
