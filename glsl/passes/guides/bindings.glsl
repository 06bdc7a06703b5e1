// Guide images for denoisers; solari_vk/passes/guides.py describes each.
#ifndef PASSES_GUIDES_BINDINGS_GLSL
#define PASSES_GUIDES_BINDINGS_GLSL

layout(set = 1, binding = 80, rgba8) uniform image2D guides_diffuse_albedo;
layout(set = 1, binding = 81, rgba8) uniform image2D guides_specular_albedo;
layout(set = 1, binding = 82, rgba16f) uniform image2D guides_normal_roughness;
layout(set = 1, binding = 83, r32f) uniform image2D guides_depth;
layout(set = 1, binding = 84, rg16f) uniform image2D guides_motion;
layout(set = 1, binding = 85, rg16f) uniform image2D guides_specular_motion;

#endif
