// Pixels without much history take more than one path, since their light is averaged over few frames. With the setting
// frame_ms all pixels take more or fewer, by chance, as the frame's time allows.
#ifndef PASSES_PATHS_SHORT_HISTORY_GLSL
#define PASSES_PATHS_SHORT_HISTORY_GLSL

#include "common/random.glsl"
#include "generated/passes/paths.glsl"
#include "passes/bindings.glsl"
#include "passes/denoise/api.glsl"

layout(constant_id = short_history_samples_id) const uint short_history_samples = 1u;  // paths of such a pixel
// The most paths of a pixel with the setting frame_ms; 0 without that.
layout(constant_id = max_timed_samples_id) const uint max_timed_samples = 0u;

// The mean number of paths that pixels take with the setting frame_ms, over the number without it.
layout(set = 1, scalar) uniform PathShareBlock { float value; } path_share;

const uint SHARE_SALT = 0x5BE0CD19u;
const uint GOLDEN_RATIO = 2654435769u;  // of 2^32

// The number of paths of a pixel, by the history of its diffuse lobe before the frame's light is added: that of
// reflections is short wherever the camera moves.
uint samples_per_pixel(uint index) {
    if (!uses_denoiser(index)) { return 1u; }
    float long_enough = min(SHORT_HISTORY, float(denoise_settings.max_history - 1u));
    float frames = history_length(index);
    uint samples = frames < long_enough ? short_history_samples : 1u;
    if (max_timed_samples == 0u) { return samples; }
    // Rounded up or down by a number that is uniform over pixels and, within a pixel, evenly spaced over frames. So the
    // chance of a path doesn't depend on what paths have found. Pixels without a frame of history, as after most of it
    // was dropped, take a path at least.
    uint offset = seed_rng(uvec2(index, 0u), 0u, this_frame.seed ^ SHARE_SALT);
    float expected = min(path_share.value * float(samples), float(max_timed_samples));
    uint chosen = uint(expected + unit_float(offset + this_frame.index * GOLDEN_RATIO));
    return clamp(chosen, frames < 1.0 ? 1u : 0u, max_timed_samples);  // unit_float rounds to 1 in sums
}

#endif
