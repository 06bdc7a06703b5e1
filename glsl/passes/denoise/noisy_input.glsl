// What is denoised: the light of a pixel's paths in this frame.
#ifndef PASSES_DENOISE_NOISY_INPUT_GLSL
#define PASSES_DENOISE_NOISY_INPUT_GLSL

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/paths/bindings.glsl"

// Demodulated radiance, and the hit distance in meters: 0 where the other lobe proposed the path's first ray, infinite
// where that ray hit no surface.
vec4 noisy_diffuse(uint index) { return paths_diffuse.at[index]; }

// Where the guides are of a PSR surface, all light of it is in the specular sample, and the diffuse one is empty.
vec4 noisy_specular(uint index, ivec2 pixel, uint kind) {
    vec4 found = paths_specular.at[index];
    return vec4(found.rgb / psr_albedo(pixel, kind), found.w);
}

#endif
