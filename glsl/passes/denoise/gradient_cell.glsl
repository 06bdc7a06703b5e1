// Gradient cells, the strata of A-SVGF: sums over CELL_SIZE x CELL_SIZE pixels (solari_vk/passes/denoise.py) of how
// much light differs from its history, and of how bright it is. Each cell's neighborhood gives the confidence in the
// history and the mean that limits fireflies.
#ifndef PASSES_DENOISE_GRADIENT_CELL_GLSL
#define PASSES_DENOISE_GRADIENT_CELL_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/denoise.glsl"  // CELL_SIZE, written by solari_vk/passes/denoise.py
#include "passes/denoise/lobe_history.glsl"
#include "passes/views.glsl"

struct Gradient {
    float difference_sum;  // luminance minus that of the history; noise of either sign cancels out
    float sum_of_squares;  // of these differences
    float sum_of_max;      // the larger of both luminances, by which A-SVGF normalizes gradients
};

struct LobeGradient {
    Gradient current;     // of this frame
    Gradient fast;        // of the fast history, LobeHistory.fast_luminance
    float variance_sum;   // of the temporal variances of one frame's luminance
    float luminance_sum;  // of the histories' means, this frame included
    float max_luminance;  // the largest of these means
    float pixels;         // the number of pixels in luminance_sum
};

struct PackedLobeGradient {
    float current_difference_sum;
    float fast_difference_sum;
    uvec4 others;
};

struct GradientCell {
    PackedLobeGradient diffuse;
    PackedLobeGradient specular;
};

// What follows from the cells around a cell, for the diffuse and the specular lobe: the confidence in the history, by
// which history lengths are multiplied (a power of A-SVGF's 1 - lambda), and the mean of the 3 x 3 cells without the
// brightest pixel, by which variance.comp clamps fireflies.
struct CellNeighborhood {
    vec2 confidence;
    vec2 trimmed_mean_luminance;
};

layout(set = 1, scalar) buffer DenoiseCellsBlock { GradientCell at[]; } denoise_cells;
layout(set = 1, scalar) buffer DenoiseNeighborhoodsBlock { CellNeighborhood at[]; } denoise_neighborhoods;

uvec2 cell_count() { return (camera.size + CELL_SIZE - 1u) / CELL_SIZE; }

uint cell_at(ivec2 pixel) { return element_index(uvec2(pixel) / CELL_SIZE, cell_count()); }

const Gradient NO_GRADIENT = Gradient(0.0, 0.0, 0.0);
const LobeGradient NO_PIXELS = LobeGradient(NO_GRADIENT, NO_GRADIENT, 0.0, 0.0, 0.0, 0.0);

PackedLobeGradient pack_gradient(LobeGradient cell, inout uint rng) {
    return PackedLobeGradient(cell.current.difference_sum, cell.fast.difference_sum, uvec4(
        pack_two(cell.current.sum_of_squares, cell.current.sum_of_max, rng),
        pack_two(cell.fast.sum_of_squares, cell.fast.sum_of_max, rng),
        pack_two(cell.variance_sum, cell.pixels, rng), pack_two(cell.luminance_sum, cell.max_luminance, rng)
    ));
}

LobeGradient unpack_gradient(PackedLobeGradient cell) {
    vec4 low, high;
    for (int i = 0; i < 4; i++) {
        low[i] = unpack_positive(cell.others[i], 16u);
        high[i] = unpack_positive(cell.others[i] >> 16u, 16u);
    }
    return LobeGradient(
        Gradient(cell.current_difference_sum, low.x, high.x), Gradient(cell.fast_difference_sum, low.y, high.y),
        low.z, low.w, high.w, high.z
    );
}

#endif
