// Fills the light tiles of a frame: each sample is a point of a triangle of a light, both chosen by their power.
// Wyman and Panteleev, "Rearchitecting Spatiotemporal Resampling for Production" (2021), section 5.
#version 460
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/solari019/light_tiles/light_tiles.glsl"

layout(local_size_x = 256) in;

layout(constant_id = samples_each_id) const uint samples_each = 1024u;

const uint PASS_SALT = 0x85EBCA6Bu;

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index == 0u) { light_tiles.samples_each = samples_each; }
    if (index >= light_tiles.at.length()) { return; }
    // Differs from Solari, whose seeds are sums, so that the tiles of successive frames overlap: a hash of frame,
    // tile and index.
    uint rng = seed_rng(
        uvec2(index / samples_each, index % samples_each), this_frame.index, this_frame.seed ^ PASS_SALT
    );
    LightCandidate candidate = draw_light_candidate(rng);
    light_tile_samples.at[index] = candidate.light_sample;
    light_tiles.at[index] = pack_light_sample(candidate.resolved);
}
