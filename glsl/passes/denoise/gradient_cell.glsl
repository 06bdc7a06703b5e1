// Sums over a cell of CELL x CELL pixels: how much light differs from its history, and how bright it is. And what the
// cells tell of the pixels among them.
#ifndef PASSES_DENOISE_GRADIENT_CELL_GLSL
#define PASSES_DENOISE_GRADIENT_CELL_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "common/pixel.glsl"
#include "generated/passes/denoise.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "scene/camera.glsl"

struct Gradient {
    float difference_sum;    // luminance minus that of the history; noise of either sign cancels out
    float squared_sum;
    float max_sum;   // of both luminances
};

struct LobeGradient {
    Gradient now;       // of this frame
    Gradient recently;  // of the latest frames
    float variance;       // of a frame, as the history lets expect
    float luminance;      // of the history with this frame
    float brightest;      // pixel of the cell
    float pixels;
};

struct PackedLobeGradient {
    float total_now;
    float total_recently;
    uvec4 others;
};

struct GradientCell {
    PackedLobeGradient diffuse;
    PackedLobeGradient specular;
};

// What the cells around one tell: the share of the histories that changes of light leave valid, and the luminance
// without the brightest pixel.
struct CellNeighborhood {
    vec2 confidence;
    vec2 luminance;
};

layout(set = 1, scalar) buffer DenoiseCellsBlock { GradientCell at[]; } denoise_cells;
layout(set = 1, scalar) buffer DenoiseBlocksBlock { CellNeighborhood at[]; } denoise_blocks;

uvec2 cell_count() { return (camera.size + CELL - 1u) / CELL; }

uint cell_at(ivec2 pixel) { return pixel_index(uvec2(pixel) / CELL, cell_count()); }

const Gradient NO_GRADIENT = Gradient(0.0, 0.0, 0.0);
const LobeGradient NO_PIXELS = LobeGradient(NO_GRADIENT, NO_GRADIENT, 0.0, 0.0, 0.0, 0.0);

PackedLobeGradient pack_gradient(LobeGradient cell, inout uint rng) {
    return PackedLobeGradient(cell.now.difference_sum, cell.recently.difference_sum, uvec4(
        pack_two(cell.now.squared_sum, cell.now.max_sum, rng), pack_two(cell.recently.squared_sum,
            cell.recently.max_sum, rng),
        pack_two(cell.variance, cell.pixels, rng), pack_two(cell.luminance, cell.brightest, rng)
    ));
}

LobeGradient unpack_gradient(PackedLobeGradient cell) {
    vec4 low, high;
    for (int i = 0; i < 4; i++) {
        low[i] = unpack_positive(cell.others[i], 16u);
        high[i] = unpack_positive(cell.others[i] >> 16u, 16u);
    }
    return LobeGradient(
        Gradient(cell.total_now, low.x, high.x), Gradient(cell.total_recently, low.y, high.y), low.z, low.w, high.w,
        high.z
    );
}

#endif
