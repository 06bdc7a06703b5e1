// ReSTIR DI, first half. Differs from Solari, which drops an occluded sample before the merge, so that shadows grow
// halos: visible_initial_and_temporal.comp.
#version 460
#include "common/pixel.glsl"
#include "passes/solari019/restir_di/initial_and_temporal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void test_visibility(GBufferSurface surface, inout DiReservoir reservoir) {}  // merged untested

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (!is_inside(pixel, camera.size)) { return; }
    write_temporal_reservoir(pixel);
}
