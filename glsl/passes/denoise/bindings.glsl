// What the denoiser keeps from frame to frame, and what its passes pass on. Each element belongs to a pixel.
#ifndef PASSES_DENOISE_BINDINGS_GLSL
#define PASSES_DENOISE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// Surfaces, packed by passes/denoise/guide.glsl.
layout(set = 1, binding = 140, scalar) buffer DenoiseGuidesBlock { uvec2 at[]; } denoise_guides;
layout(set = 1, binding = 141, scalar) buffer PreviousDenoiseGuidesBlock { uvec2 at[]; } previous_denoise_guides;
// The light of a lobe over frames, packed by passes/denoise/lobe.glsl.
layout(set = 1, binding = 142, scalar) buffer DenoiseDiffuseBlock { uvec4 at[]; } denoise_diffuse;
layout(set = 1, binding = 143, scalar) buffer PreviousDenoiseDiffuseBlock { uvec4 at[]; } previous_denoise_diffuse;
layout(set = 1, binding = 144, scalar) buffer DenoiseSpecularBlock { uvec4 at[]; } denoise_specular;
layout(set = 1, binding = 145, scalar) buffer PreviousDenoiseSpecularBlock { uvec4 at[]; } previous_denoise_specular;
// The light of both lobes while it is filtered, packed by passes/denoise/lobe.glsl. Filters read one and write another.
layout(set = 1, binding = 147, scalar) buffer DenoiseEvenBlock { uvec4 at[]; } denoise_even;
layout(set = 1, binding = 148, scalar) buffer DenoiseOddBlock { uvec4 at[]; } denoise_odd;
// The luminance of both lobes, averaged over 3 x 3 pixels.
layout(set = 1, binding = 149, scalar) buffer DenoiseLuminanceBlock { vec2 at[]; } denoise_luminance;
// The estimated standard error of the luminance of `sample_radiance`, in cd/m^2. The result `frame["error"]`.
layout(set = 1, binding = 152, scalar) buffer ErrorBlock { float at[]; } error;

#endif
