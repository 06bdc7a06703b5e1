// What the light tiles hold: samples of lights, chosen and resolved ahead of the passes that choose among them.
#ifndef PASSES_LIGHT_TILES_BINDINGS_GLSL
#define PASSES_LIGHT_TILES_BINDINGS_GLSL

#include "passes/bindings.glsl"
#include "scene/sampling.glsl"

struct PackedLightSample {
    vec3 world_position;  // or direction
    uint world_normal;    // octahedral 2x16
    uint radiance;        // rgb9e5, as light_tiles_settings.encoding says
    // Negative: a direction. Its lowest bit: double-sided. A number that the eye can read in a dump, off by 1 in 10^7.
    float inverse_pdf;
};

// Tile after tile.
layout(set = 1, binding = 32, scalar) buffer LightTileSamplesBlock { LightSample at[]; } light_tile_samples;
layout(set = 1, binding = 33, scalar) buffer LightTilesBlock {
    uint samples_each;
    PackedLightSample at[];  // of light_tile_samples, resolved
} light_tiles;

#endif
