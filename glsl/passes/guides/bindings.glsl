// Guide images for denoisers; solari_vk/passes/guides.py describes each.
#ifndef PASSES_GUIDES_BINDINGS_GLSL
#define PASSES_GUIDES_BINDINGS_GLSL

layout(set = 1, rgba8) uniform image2D guides_diffuse_albedo;
layout(set = 1, rgba8) uniform image2D guides_specular_albedo;
layout(set = 1, rgba16f) uniform image2D guides_normal_roughness;
layout(set = 1, r32f) uniform image2D guides_depth;
layout(set = 1, rg16f) uniform image2D guides_motion;
layout(set = 1, rg16f) uniform image2D guides_specular_motion;

#endif
