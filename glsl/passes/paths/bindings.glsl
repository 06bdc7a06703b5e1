// What the paths of a frame found for each pixel.
#ifndef PASSES_PATHS_BINDINGS_GLSL
#define PASSES_PATHS_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// The light of a lobe at the pixel's surface over the lobe's demodulation, and the distance to where the light of this
// lobe came from: the length of the path's first ray, 0 when the other lobe proposed it.
layout(set = 1, binding = 70, scalar) buffer PathsDiffuseBlock { vec4 at[]; } paths_diffuse;
layout(set = 1, binding = 71, scalar) buffer PathsSpecularBlock { vec4 at[]; } paths_specular;

#endif
