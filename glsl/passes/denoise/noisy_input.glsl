// The denoiser's noisy input: the light of a pixel's paths in this frame.
#ifndef PASSES_DENOISE_NOISY_INPUT_GLSL
#define PASSES_DENOISE_NOISY_INPUT_GLSL

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/paths/bindings.glsl"

// Whether a frame may trace no path for some of its pixels, to keep within the time of the setting frame_ms.
layout(constant_id = skips_pixels_id) const bool skips_pixels = false;

bool has_no_path(vec4 radiance_hit_distance) { return skips_pixels && radiance_hit_distance.w == NO_PATH; }

// Demodulated radiance, and the hit distance in meters: the length of the first ray of the pixel's first path whose
// first ray was sampled from this lobe; 0 if there is none, infinite where the ray hit no surface. With restir
// the distance to the reservoir's sample, for the specular lobe only where that is reused.
vec4 noisy_diffuse(uint index) { return paths_diffuse.at[index]; }

// All light of a PSR surface is in the specular signal; the diffuse one is black.
vec4 noisy_specular(uint index, ivec2 pixel, uint kind) {
    vec4 found = paths_specular.at[index];
    return vec4(found.rgb / psr_albedo(pixel, kind), found.w);
}

#endif
