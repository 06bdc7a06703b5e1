// Adds up for each block of pixels the light that is kept, and what variance.comp has taken from fireflies: how much
// less light the input of the blur has than the histories.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/guide.glsl"
#include "passes/denoise/removed_light.glsl"
#include "passes/denoise/signal.glsl"

layout(local_size_x = LIGHT_BLOCK_SIZE, local_size_y = LIGHT_BLOCK_SIZE) in;  // a workgroup for each block

const float MAX_ROUNDING = 0.02;  // packed signals may have so much less light, of which nothing was taken

// The luminance that is kept of a lobe, and what was taken from it.
vec2 kept_and_removed(LobeHistory history, Signal signal) {
    if (signal.standard_error < 0.0) { return vec2(0.0); }
    float kept = luminance(signal.radiance), before = luminance(history.radiance);
    return vec2(kept, kept < (1.0 - MAX_ROUNDING) * before ? before - kept : 0.0);
}

shared BlockLight pixels[LIGHT_BLOCK_SIZE * LIGHT_BLOCK_SIZE];

void main() {
    uvec2 block = gl_WorkGroupID.xy, within = gl_LocalInvocationID.xy;
    uint block_index, thread = gl_LocalInvocationIndex;
    if (denoise_settings.denoise == 0u || !find_element(block, block_count(), block_index)) { return; }
    uvec2 pixel = block * LIGHT_BLOCK_SIZE + within;
    BlockLight found = BlockLight(vec2(0.0), vec2(0.0));
    if (all(lessThan(pixel, camera.size))) {
        uint index = element_index(pixel, camera.size);
        if (kind_of(denoise_guides.at[index]) != NOT_DENOISED) {
            Signals signals = unpack_signals(denoise_ping.at[index].xyz);
            vec2 diffuse = kept_and_removed(unpack_lobe_history(denoise_diffuse.at[index]), signals.diffuse);
            vec2 specular = kept_and_removed(unpack_lobe_history(denoise_specular.at[index]), signals.specular);
            found = BlockLight(vec2(diffuse.x, specular.x), vec2(diffuse.y, specular.y));
        }
    }
    pixels[thread] = found;
    barrier();
    for (uint half_count = LIGHT_BLOCK_SIZE * LIGHT_BLOCK_SIZE / 2u; half_count > 0u; half_count /= 2u) {
        if (thread < half_count) {
            pixels[thread].kept += pixels[thread + half_count].kept;
            pixels[thread].removed += pixels[thread + half_count].removed;
        }
        barrier();
    }
    if (thread == 0u) { denoise_blocks.at[block_index] = pixels[0]; }
}
