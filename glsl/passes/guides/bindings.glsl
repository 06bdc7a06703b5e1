// Guide images for denoisers; solari_vk/passes/guides.py describes each. They describe the primary surface of a pixel,
// or the PSR surface that replaces it (primary surface replacement).
#ifndef PASSES_GUIDES_BINDINGS_GLSL
#define PASSES_GUIDES_BINDINGS_GLSL

layout(set = 1, rgba8) uniform image2D guides_diffuse_albedo;   // alpha: 0 for mirrors that show a light or nothing
layout(set = 1, rgba8) uniform image2D guides_specular_albedo;  // alpha: 1 for primary surfaces, 0 for PSR surfaces
layout(set = 1, rgba16f) uniform image2D guides_normal_roughness;
layout(set = 1, r32f) uniform image2D guides_depth;
layout(set = 1, rg16f) uniform image2D guides_motion;           // of the primary surface
layout(set = 1, rg16f) uniform image2D guides_specular_motion;  // the same, or of the PSR surface that replaces it

#endif
