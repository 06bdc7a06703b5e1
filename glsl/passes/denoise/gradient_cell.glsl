// Sums over a cell of CELL x CELL pixels (the strata of A-SVGF; solari_vk/passes/denoise.py has the size): how much
// light differs from its history, and how bright it is. And what the cells around a cell tell of its pixels.
#ifndef PASSES_DENOISE_GRADIENT_CELL_GLSL
#define PASSES_DENOISE_GRADIENT_CELL_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/passes/denoise.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/views.glsl"

struct Gradient {
    float difference_sum;  // luminance minus that of the history; noise of either sign cancels out
    float sum_of_squares;     // of these differences
    float sum_of_max;         // the larger of both luminances, by which A-SVGF normalizes gradients
};

struct LobeGradient {
    Gradient current;     // of this frame
    Gradient fast;         // of the fast history, LobeHistory.fast_luminance
    float variance_sum;   // of one frame's luminance (temporal)
    float luminance_sum;  // of means that include this frame
    float max_luminance;  // the largest of these
    float pixels;
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

// What the cells around one tell of each lobe: the confidence in the history, which is the share of it that changes of
// light leave valid (a power of A-SVGF's 1 - lambda), and the luminance by which variance.comp clamps fireflies.
struct CellNeighborhood {
    vec2 confidence;
    vec2 trimmed_mean_luminance;
};

layout(set = 1, scalar) buffer DenoiseCellsBlock { GradientCell at[]; } denoise_cells;
layout(set = 1, scalar) buffer DenoiseNeighborhoodsBlock { CellNeighborhood at[]; } denoise_neighborhoods;

uvec2 cell_count() { return (camera.size + CELL - 1u) / CELL; }

uint cell_at(ivec2 pixel) { return element_index(uvec2(pixel) / CELL, cell_count()); }

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
