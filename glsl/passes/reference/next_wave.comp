// Begins a wave of paths with those that wait; before paths start, with none, since a frame may have been interrupted.
#version 460
#include "passes/reference/bindings.glsl"

layout(local_size_x = 1) in;

layout(constant_id = begins_dispatch_id) const bool begins_dispatch = false;

void main() {
    wave.index += 1u;
    wave.count = begins_dispatch ? 0u : wave.queued;
    wave.queued = 0u;
    wave.dispatch = make_indirect_dispatch(wave.count, 1u);
}
