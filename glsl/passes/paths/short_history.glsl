// How many paths a pixel takes: more than one if its history is short, since its light is averaged over few frames.
// With the setting frame_ms all pixels take more or fewer, by chance, as the frame's time allows.
#ifndef PASSES_PATHS_SHORT_HISTORY_GLSL
#define PASSES_PATHS_SHORT_HISTORY_GLSL

#include "common/random.glsl"
#include "generated/passes/paths.glsl"  // SHORT_HISTORY, written by solari_vk/passes/paths.py
#include "passes/bindings.glsl"
#include "passes/denoise/api.glsl"

layout(constant_id = short_history_samples_id) const uint short_history_samples = 1u;  // paths of such a pixel
// The most paths of a pixel with the setting frame_ms; 0 without that.
layout(constant_id = max_timed_samples_id) const uint max_timed_samples = 0u;

// With the setting frame_ms: the factor of each pixel's expected number of paths, which may be above 1.
layout(set = 1, scalar) uniform PathShareBlock { float value; } path_share;

const uint SHARE_SALT = 0x5BE0CD19u;
const uint GOLDEN_RATIO = 2654435769u;  // 2^32 over it

// The number of paths of a pixel, by the length of its history before this frame. It is that of the diffuse lobe, since
// that of the specular lobe is short wherever the camera moves.
uint samples_per_pixel(uint index) {
    if (!uses_denoiser(index)) { return 1u; }
    float long_enough = min(SHORT_HISTORY, float(denoise_settings.max_history - 1u));
    float frames = history_length(index);
    uint samples = frames < long_enough ? short_history_samples : 1u;
    if (max_timed_samples == 0u) { return samples; }
    // The expected number is rounded up or down at random, with a number that is uniform over pixels and a golden ratio
    // (Weyl) sequence over frames, so that the choice doesn't depend on what paths have found. Pixels with less than
    // one frame of history take one path at least.
    uint offset = seed_rng(uvec2(index, 0u), 0u, this_frame.seed ^ SHARE_SALT);
    float expected = min(path_share.value * float(samples), float(max_timed_samples));
    uint chosen = uint(expected + unit_float(offset + this_frame.index * GOLDEN_RATIO));
    return clamp(chosen, frames < 1.0 ? 1u : 0u, max_timed_samples);  // the sum may round up to one more
}

#endif
