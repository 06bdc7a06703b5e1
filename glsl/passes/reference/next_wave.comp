// Begins a wave of paths with those that wait.
#version 460
#include "passes/reference/wave.glsl"

layout(local_size_x = 1) in;

layout(constant_id = wave_index_id) const uint wave_index = 0u;

void main() {
    wave.index = wave_index;
    wave.count = wave.queued;
    wave.queued = 0u;
    wave.dispatch = make_indirect_dispatch(wave.count, 1u);
}
