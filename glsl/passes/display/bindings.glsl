// The display's settings, and its output picture.
#ifndef PASSES_DISPLAY_BINDINGS_GLSL
#define PASSES_DISPLAY_BINDINGS_GLSL

#include "passes/bindings.glsl"

layout(set = 1, scalar) uniform DisplaySettingsBlock {
    uint debug_view;  // index into DEBUG_VIEWS of solari_vk/passes/debug_views.py; 0: the picture
    uint tonemap;  // TONEMAP_*
} display_settings;
layout(set = 1, rgba8) uniform image2D display;

#endif
