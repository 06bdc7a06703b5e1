// Buffers, bound by name: the light that a frame's paths find for each pixel, and the paths that go on after their
// first ray. solari_vk/passes/paths.py has their sizes.
#ifndef PASSES_PATHS_BINDINGS_GLSL
#define PASSES_PATHS_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/paths/stored_path.glsl"
#include "passes/rows.glsl"  // IndirectDispatch

// rgb: radiance of a lobe, demodulated at the pixel's surface. w: its hit distance, the length of the first ray
// (infinite without a hit) of the pixel's first path that sampled its direction from this lobe; 0 if none did; NO_PATH
// if the pixel takes no path in this frame. With restir it is the distance to the reservoir's sample, for the specular
// lobe only where that is reused.
layout(set = 1, scalar) buffer PathsDiffuseBlock { vec4 at[]; } paths_diffuse;
layout(set = 1, scalar) buffer PathsSpecularBlock { vec4 at[]; } paths_specular;
const float NO_PATH = -1.0;
// Radiance before the denoiser.
layout(set = 1, scalar) buffer RawRadianceBlock { vec3 at[]; } raw_radiance;
// The estimated standard error of the luminance of `sample_radiance`, the frame before antialiasing, in cd/m^2. The
// result `frame["error"]`.
layout(set = 1, scalar) buffer ErrorBlock { float at[]; } error;

// By pixel: passes/paths/path_state.glsl.
layout(set = 1, scalar) buffer PathsStatesBlock { uvec4 quads[]; } paths_states;
// For passes/paths/trace.comp, which only traces: the rays that paths have chosen, and what it has found.
layout(set = 1, scalar) buffer PathsRaysBlock { uvec4 quads[]; } paths_rays;
layout(set = 1, scalar) buffer PathsHitsBlock { uvec4 quads[]; } paths_hits;
// Ray queues of the indices of pixels whose paths wait: one of waves with even index, then one of waves with odd index.
// Each view has a part of its own, so that a workgroup's rays are in one world, the scene that the view shows.
layout(set = 1, scalar) buffer PathsRayQueuesBlock { uint at[]; } paths_ray_queues;
// By view: the indices of the pixels with a short history, which take several paths (passes/paths/short_history.glsl).
layout(set = 1, scalar) buffer PathsShortHistoriesBlock { uint at[]; } paths_short_histories;
// With the settings frame_ms and upscale: the indices of the pixels that take a path, of all views.
layout(set = 1, scalar) buffer PathsChosenBlock {
    uint count;
    uint at[];
} paths_chosen;
struct PathQueue {
    uint count;   // of paths that go on in this wave
    uint queued;  // of paths that wait for the next wave, so far
    uint short_history_count;
};
layout(set = 1, scalar) buffer PathsQueuesBlock { PathQueue at[]; } paths_queues;  // by view
layout(set = 1, scalar) buffer PathsWaveBlock {
    IndirectDispatch dispatch;  // with a layer for each view
    uint index;
    uint sample_index;  // which path of each pixel is traced now, from 0
} paths_wave;

// ---- reuse between pixels, with the setting restir: passes/paths/reservoir.glsl -----------------------

// The two candidates that a path gives to its pixel's reservoir: a point of a light, and the path's second vertex, x2.
struct ReservoirCandidate {
    uvec4 light;         // a point of a light, as PathReservoir.point
    float light_resampling_weight;  // the target function times the unbiased contribution weight
    float path_contribution_weight;    // W: one over the pdf of x2 as the first ray's hit; 0 without a hit
    vec3 position;       // of x2, moved off its surface
    uint normal;
    uint instance;
    vec3 radiance;       // that leaves x2 towards the pixel by the diffuse lobe
};
layout(set = 1, scalar) buffer PathsReservoirCandidatesBlock { ReservoirCandidate at[]; } paths_reservoir_candidates;

struct PathReservoir {
    // Of a light: its index, its part (triangle or texel), and as floats the random numbers in [0, 1) that choose a
    // point of the part (argument `u` of resolve_light, a function that solari_vk/bound/lights/light_kinds.py writes).
    // Of a hit: its position, moved off the surface, as floats, and its geometric normal, octahedral.
    uvec4 point;
    vec3 radiance;     // of a hit, towards the pixel
    float confidence;  // M in ReSTIR
    float weight;      // unbiased contribution weight W; 0 when no light was found
    uint instance;     // of the hit; NO_INDEX for a light
};
layout(set = 1, scalar) buffer PathsTemporalReservoirsBlock {
    PathReservoir at[];
} paths_temporal_reservoirs;
// Temporal reuse reads those of the previous frame, spatial reuse replaces them.
layout(set = 1, scalar) buffer PathsReservoirsBlock { PathReservoir at[]; } paths_reservoirs;

#endif
