// Sets the frame's counters to zero.
#version 460
#include "passes/gbuffer/bindings.glsl"

layout(local_size_x = 1) in;

void main() {
    draw_counts.at[0] = draw_counts.at[1] = uvec2(0u);
    gbuffer_counters.drawn_first = gbuffer_counters.drawn_second = 0u;
    gbuffer_counters.frustum_culled = gbuffer_counters.occlusion_culled = 0u;
}
