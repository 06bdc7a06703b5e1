// The light tiles: light samples, drawn and resolved before the passes that choose among them.
#ifndef PASSES_SOLARI019_LIGHT_TILES_BINDINGS_GLSL
#define PASSES_SOLARI019_LIGHT_TILES_BINDINGS_GLSL

#include "passes/bindings.glsl"
#include "scene/lights/types.glsl"

// 32 bytes of a ResolvedLightSample, which GPUs read by 16 at once.
struct PackedLightSample {
    vec3 world_position;
    uint world_normal;   // octahedral 2x16
    uint radiance;       // rgb9e5 of log2(1 + radiance * exposure)
    float inverse_area_pdf;
    uint kind;
    uint data;
};

// The samples of the first tile, then those of the second, and so on.
layout(set = 1, scalar) buffer LightTileSamplesBlock { LightSample at[]; } light_tile_samples;
layout(set = 1, scalar) buffer LightTilesBlock {
    uint samples_each;
    layout(offset = 16) PackedLightSample at[];  // of light_tile_samples, resolved
} light_tiles;

#endif
