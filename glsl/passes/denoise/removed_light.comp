// Adds up for each block of pixels the light that is kept, and what variance.comp has taken from fireflies: how much
// less light the input of the blur has than the histories.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/guide.glsl"
#include "passes/denoise/removed_light.glsl"
#include "passes/denoise/signal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const float MAX_ROUNDING = 0.02;  // packed signals may have so much less light, of which nothing was taken

// The luminance that is kept of a lobe, and what was taken from it.
vec2 kept_and_removed(LobeHistory history, Signal signal) {
    if (signal.standard_error < 0.0) { return vec2(0.0); }
    float kept = luminance(signal.radiance), before = luminance(history.radiance);
    return vec2(kept, kept < (1.0 - MAX_ROUNDING) * before ? before - kept : 0.0);
}

void main() {
    uvec2 block = gl_GlobalInvocationID.xy;
    uint block_index;
    if (denoise_settings.denoise == 0u || !find_element(block, block_count(), block_index)) { return; }
    uvec2 begin = block * LIGHT_BLOCK_SIZE, end = min(begin + LIGHT_BLOCK_SIZE, camera.size);
    mat2 sum = mat2(0.0);  // a column for each lobe
    for (uint y = begin.y; y < end.y; y++) {
        for (uint x = begin.x; x < end.x; x++) {
            uint index = element_index(uvec2(x, y), camera.size);
            if (kind_of(denoise_guides.at[index]) == NOT_DENOISED) { continue; }
            Signals signals = unpack_signals(denoise_ping.at[index].xyz);
            sum[0] += kept_and_removed(unpack_lobe_history(denoise_diffuse.at[index]), signals.diffuse);
            sum[1] += kept_and_removed(unpack_lobe_history(denoise_specular.at[index]), signals.specular);
        }
    }
    denoise_blocks.at[block_index] = BlockLight(vec2(sum[0].x, sum[1].x), vec2(sum[0].y, sum[1].y));
}
