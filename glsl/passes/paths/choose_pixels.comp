// With the settings frame_ms and upscale: lists the pixels that take a path in this frame. Those of a workgroup are
// neighbors in the list, so that subgroups trace coherent rays. The other pixels have no sample.
#version 460
#include "passes/paths/bindings.glsl"
#include "passes/paths/short_history.glsl"  // and passes/views.glsl: find_pixel gives the pixel's index in buffers

layout(local_size_x = 8, local_size_y = 8) in;

shared uint group_count, group_begin;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    bool inside = find_pixel(pixel, index);
    bool chosen = inside && samples_per_pixel(index) > 0u;
    if (gl_LocalInvocationIndex == 0u) { group_count = 0u; }
    barrier();
    uint slot = chosen ? atomicAdd(group_count, 1u) : 0u;
    barrier();
    if (gl_LocalInvocationIndex == 0u) { group_begin = atomicAdd(paths_chosen.count, group_count); }
    barrier();
    if (chosen) {
        paths_chosen.at[group_begin + slot] = index;
    } else if (inside) {
        paths_diffuse.at[index] = paths_specular.at[index] = vec4(vec3(0.0), NO_PATH);
    }
}
