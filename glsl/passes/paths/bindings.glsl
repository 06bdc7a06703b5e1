// What the paths of a frame found for each pixel, and the paths that go on after their first ray.
#ifndef PASSES_PATHS_BINDINGS_GLSL
#define PASSES_PATHS_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/paths/lobes.glsl"
#include "passes/rows.glsl"

// The light of a lobe at the pixel's surface over the lobe's demodulation, and the distance to where the light of this
// lobe came from: the length of the path's first ray, 0 when the other lobe proposed it.
layout(set = 1, binding = 70, scalar) buffer PathsDiffuseBlock { vec4 at[]; } paths_diffuse;
layout(set = 1, binding = 71, scalar) buffer PathsSpecularBlock { vec4 at[]; } paths_specular;
// Radiance without the denoiser.
layout(set = 1, binding = 89, scalar) buffer RawRadianceBlock { vec3 at[]; } raw_radiance;

// A path that waits for its next ray, apart from what the pass that goes on with it computes again.
struct WaitingPath {
    uint rng;
    uint state;  // number of rays | number of them that left mirrors << 8 | REFLECTS_ONLY
    Lobes first_weight;
    vec3 throughput;
    vec3 direction;
    uint instance;
    uint triangle;
    vec2 barycentrics;
    float squared_slope;
    float spread;
    float cone_width;
};
layout(set = 1, binding = 72, scalar) buffer PathsWaitingBlock { WaitingPath at[]; } paths_waiting;  // by pixel
// The indices of the pixels whose paths wait: for rounds with even index, then for those with odd index.
layout(set = 1, binding = 73, scalar) buffer PathsListsBlock { uint at[]; } paths_lists;
layout(set = 1, binding = 74, scalar) buffer PathsRoundBlock {
    IndirectDispatch size;
    uint index;
    uint count;    // of paths that go on in this round
    uint arrived;  // of paths that wait for the next round, so far
} paths_round;

#endif
