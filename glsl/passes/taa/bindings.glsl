// What antialiasing keeps from frame to frame, for each pixel of the picture; packed by passes/taa/history.glsl.
#ifndef PASSES_TAA_BINDINGS_GLSL
#define PASSES_TAA_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

layout(set = 1, scalar) buffer TaaHistoryBlock { uvec2 at[]; } taa_history;
layout(set = 1, scalar) buffer PreviousTaaHistoryBlock { uvec2 at[]; } previous_taa_history;

#endif
