// Draws a debug view of the frame with lighting=paths.
#version 460
#define LIGHTING_PATHS  // read by generated/passes/debug_views.glsl
#include "passes/display/debug_view.glsl"
