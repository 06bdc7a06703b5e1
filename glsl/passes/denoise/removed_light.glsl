// The light that variance.comp has taken from fireflies. It is spread over what is around, so that none is lost: each
// block of pixels gives what was taken from it to the blocks in its neighborhood, in the ratio of the light that they
// have. What is black stays black, and edges stay where they are.
#ifndef PASSES_DENOISE_REMOVED_LIGHT_GLSL
#define PASSES_DENOISE_REMOVED_LIGHT_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/denoise.glsl"  // LIGHT_BLOCK_SIZE, written by solari_vk/passes/denoise.py
#include "passes/views.glsl"

// Sums of luminances over a block, of the diffuse and of the specular lobe. Colors would be seen far from where they
// come from.
struct BlockLight {
    vec2 kept;
    vec2 removed;
};

layout(set = 1, scalar) buffer DenoiseBlocksBlock { BlockLight at[]; } denoise_blocks;
// Of each lobe: the light removed from a block over that of its neighborhood; what a block gets over what it has.
layout(set = 1, scalar) buffer DenoiseSharesBlock { vec2 at[]; } denoise_shares;
layout(set = 1, scalar) buffer DenoiseGainsBlock { vec2 at[]; } denoise_gains;

const uint HEIGHT_PER_BLOCK = 128u;  // a neighborhood's radius has a block for so many rows of the picture
const int MAX_RADIUS = 4;            // in blocks
const float MAX_GAIN = 63.0;         // of a block's light

uvec2 block_count() { return (camera.size + LIGHT_BLOCK_SIZE - 1u) / LIGHT_BLOCK_SIZE; }

// The radius of a neighborhood, in blocks. In small pictures blocks that are near each other show things far apart.
int spread_radius() { return clamp(int(camera.size.y / HEIGHT_PER_BLOCK), 1, MAX_RADIUS); }

// The weight of a block in the neighborhood of another.
float spread_weight(ivec2 step) {
    ivec2 near = spread_radius() + 1 - abs(step);
    return float(near.x * near.y);
}

// What the lobes of a pixel get, over the light that they have.
vec2 gains_at(uvec2 pixel) {
    vec2 place = (vec2(pixel) + 0.5) / float(LIGHT_BLOCK_SIZE) - 0.5, corner = floor(place), between = place - corner;
    vec2 gains = vec2(0.0);
    for (int i = 0; i < 4; i++) {
        vec2 side = vec2(i % 2, i / 2), weights = mix(1.0 - between, between, side);
        ivec2 block = clamp(ivec2(corner + side), ivec2(0), ivec2(block_count()) - 1);
        gains += weights.x * weights.y * denoise_gains.at[element_index(uvec2(block), block_count())];
    }
    return gains;
}

#endif
