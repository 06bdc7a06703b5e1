// Spreads the light that was taken from fireflies, in two passes over blocks. The first divides what was taken from a
// block by the weighted light of its neighborhood; the second adds up what a block gets from its neighborhood.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/denoise/removed_light.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(constant_id = gathers_id) const bool gathers = false;

void main() {
    uvec2 found = gl_GlobalInvocationID.xy, blocks = block_count();
    uint index;
    if (denoise_settings.denoise == 0u || !find_element(found, blocks, index)) { return; }
    vec2 sum = vec2(0.0);
    int radius = spread_radius();
    for (int y = -radius; y <= radius; y++) {
        for (int x = -radius; x <= radius; x++) {
            ivec2 other = ivec2(found) + ivec2(x, y);
            if (!is_inside(other, blocks)) { continue; }
            uint other_index = element_index(uvec2(other), blocks);
            sum += spread_weight(ivec2(x, y))
                * (gathers ? denoise_shares.at[other_index] : denoise_blocks.at[other_index].kept);
        }
    }
    if (gathers) {
        denoise_gains.at[index] = min(sum, vec2(MAX_GAIN));
    } else {
        vec2 share = denoise_blocks.at[index].removed / sum;
        denoise_shares.at[index] = mix(vec2(0.0), share, greaterThan(sum, vec2(0.0)));
    }
}
