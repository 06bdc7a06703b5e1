// Begins a wave of paths with those that wait.
#version 460
#include "passes/reference/bindings.glsl"

layout(local_size_x = 1) in;

void main() {
    wave.index += 1u;
    wave.count = wave.queued;
    wave.queued = 0u;
    wave.dispatch = make_indirect_dispatch(wave.count, 1u);
}
