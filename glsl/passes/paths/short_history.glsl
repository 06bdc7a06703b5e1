// Pixels without much history take more than one path, since their light is averaged over few frames.
#ifndef PASSES_PATHS_SHORT_HISTORY_GLSL
#define PASSES_PATHS_SHORT_HISTORY_GLSL

#include "passes/denoise/api.glsl"

layout(constant_id = short_history_samples_id) const uint short_history_samples = 1u;  // paths of such a pixel

const float SHORT_HISTORY = 8.0;  // frames of history from which one path is enough

// The number of paths of a pixel, by the history of its diffuse lobe before the frame's light is added: that of
// reflections is short wherever the camera moves.
uint samples_per_pixel(uint index) {
    if (!uses_denoiser(index)) { return 1u; }
    float long_enough = min(SHORT_HISTORY, float(denoise_settings.max_history - 1u));
    return history_length(index) < long_enough ? short_history_samples : 1u;
}

#endif
