// Draws a debug view of the frame with lighting=split.
#version 460
#define LIGHTING_SPLIT  // read by generated/passes/debug_views.glsl
#include "passes/solari019/debug_views.glsl"
#include "passes/display/debug_view.glsl"
