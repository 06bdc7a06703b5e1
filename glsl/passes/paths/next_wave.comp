// Begins a wave: as many threads as paths wait. Wave 0 is that of the first rays.
#version 460
#include "passes/paths/bindings.glsl"

layout(local_size_x = 1) in;

layout(constant_id = wave_index_id) const uint wave_index = 0u;
layout(constant_id = sample_index_id) const uint sample_index = 0u;

void main() {
    paths_wave.sample_index = sample_index;
    paths_wave.index = wave_index;
    paths_wave.count = paths_wave.queued;
    paths_wave.dispatch = make_indirect_dispatch(paths_wave.queued);
    paths_wave.queued = 0u;
}
