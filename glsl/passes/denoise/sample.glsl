// The light of a pixel's paths, as the denoiser takes it.
#ifndef PASSES_DENOISE_SAMPLE_GLSL
#define PASSES_DENOISE_SAMPLE_GLSL

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/paths/bindings.glsl"

// Radiance, and the distance to where it came from: paths_diffuse.
vec4 diffuse_sample(uint index) { return paths_diffuse.at[index]; }

vec4 specular_sample(uint index, ivec2 pixel, uint kind) {
    vec4 found = paths_specular.at[index];
    return vec4(found.rgb / replaced_albedo(pixel, kind), found.w);
}

#endif
