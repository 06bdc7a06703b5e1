// Draws the debug view display_settings.debug_view over the picture; 0 leaves the picture as it is.
#ifndef PASSES_DISPLAY_DEBUG_VIEW_GLSL
#define PASSES_DISPLAY_DEBUG_VIEW_GLSL

#include "common/pixel.glsl"
#include "passes/display/bindings.glsl"
#include "passes/display/debug_views.glsl"
#include "generated/passes/debug_views.glsl"  // show_debug_view, written by solari_vk/passes/debug_views.py

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (display_settings.debug_view == 0u || !is_inside(at, camera.picture_size)) { return; }
    uvec2 pixel = at * camera.size / camera.picture_size;
    imageStore(display, ivec2(at), vec4(show_debug_view(display_settings.debug_view, pixel), 1.0));
}

#endif
