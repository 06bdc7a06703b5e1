// What is denoised: the light of a pixel's paths in this frame.
#ifndef PASSES_DENOISE_NOISY_INPUT_GLSL
#define PASSES_DENOISE_NOISY_INPUT_GLSL

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/paths/bindings.glsl"

// Whether some pixels take no path: the setting frame_ms.
layout(constant_id = skips_pixels_id) const bool skips_pixels = false;

bool has_no_path(vec4 radiance_hit_distance) { return skips_pixels && radiance_hit_distance.w == NO_PATH; }

// Demodulated radiance, and the hit distance in meters: of the first path of the pixel whose first ray this lobe
// proposed; 0 if it proposed none, infinite where that ray hit no surface; with restir see paths/bindings.glsl.
vec4 noisy_diffuse(uint index) { return paths_diffuse.at[index]; }

// Where the guides are of a PSR surface, all light of it is in the specular sample, and the diffuse one is empty.
vec4 noisy_specular(uint index, ivec2 pixel, uint kind) {
    vec4 found = paths_specular.at[index];
    return vec4(found.rgb / psr_albedo(pixel, kind), found.w);
}

#endif
