// ReSTIR DI, first half. Differs from Solari, which drops an occluded sample before the merge, so that shadows grow
// halos: visible_initial_and_temporal.comp.
#version 460
#include "passes/restir_di/initial_and_temporal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    DiReservoir reservoir = EMPTY_DI_RESERVOIR;
    if (takes_di(surface)) {
        uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
        reservoir = generate_initial_reservoir(pixel, surface, rng);
        reservoir = merge_with_previous(pixel, surface, reservoir, rng);
    }
    di_temporal_reservoirs.at[pixel.y * camera.size.x + pixel.x] = reservoir;
}
