// Draws a debug view of the frame with lighting=paths.
#version 460
#include "passes/display/debug_view.glsl"
