// What the denoiser keeps from frame to frame, and what each pass hands to the next. Each element belongs to a pixel.
#ifndef PASSES_DENOISE_BINDINGS_GLSL
#define PASSES_DENOISE_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// Surfaces, packed by passes/denoise/guide.glsl.
layout(set = 1, scalar) buffer DenoiseGuidesBlock { uvec2 at[]; } denoise_guides;
layout(set = 1, scalar) buffer PreviousDenoiseGuidesBlock { uvec2 at[]; } previous_denoise_guides;
// The light of a lobe over frames, packed by passes/denoise/lobe_history.glsl.
layout(set = 1, scalar) buffer DenoiseDiffuseBlock { uvec4 at[]; } denoise_diffuse;
layout(set = 1, scalar) buffer PreviousDenoiseDiffuseBlock { uvec4 at[]; } previous_denoise_diffuse;
layout(set = 1, scalar) buffer DenoiseSpecularBlock { uvec4 at[]; } denoise_specular;
layout(set = 1, scalar) buffer PreviousDenoiseSpecularBlock { uvec4 at[]; } previous_denoise_specular;
// Ping-pong buffers of variance.comp and blur.comp. They lie in the memory of previous_denoise_diffuse and
// previous_denoise_specular, as buffers of later passes lie in that of all previous histories, so that nothing after
// reproject.comp may read those. The first three words hold the light of both lobes, packed by
// passes/denoise/signal.glsl. For the first pass of the blur, the last word holds the mean luminances of 3 x 3 pixels.
layout(set = 1, scalar) buffer DenoisePingBlock { uvec4 at[]; } denoise_ping;
layout(set = 1, scalar) buffer DenoisePongBlock { uvec4 at[]; } denoise_pong;

#endif
