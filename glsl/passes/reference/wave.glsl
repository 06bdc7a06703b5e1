// The wave of paths that is traced now: passes/reference/waves.glsl.
#ifndef PASSES_REFERENCE_WAVE_GLSL
#define PASSES_REFERENCE_WAVE_GLSL

#include "passes/rows.glsl"  // IndirectDispatch, thread_index

layout(set = 1, scalar) buffer WaveBlock {
    IndirectDispatch dispatch;
    uint index;
    uint count;   // of paths in this wave
    uint queued;  // of paths that wait for the next wave, so far
} wave;

#endif
