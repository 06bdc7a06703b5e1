// Merges of reservoirs, streams of weights, and the permutation of pixels.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "passes/solari019/restir_di/reservoir.glsl"
#include "passes/reuse.glsl"

layout(local_size_x = 64) in;

struct Merge {
    vec2 confidences;
    vec2 weights;  // unbiased contribution weights
    vec2 here;
    vec2 there;
    uint rng;
};
struct Merged {
    uint choice;  // 1 or 2: the reservoir's; NO_INDEX: neither
    float confidence;
    float weight;
};
struct Stream {
    float weights[4];
    uint rng;
};
struct Chosen {
    uint index;
    float sum;
};

layout(set = 1, scalar) readonly buffer MergesBlock { Merge at[]; } merges;
layout(set = 1, scalar) buffer MergedBlock { Merged at[]; } merged;
layout(set = 1, scalar) readonly buffer StreamsBlock { Stream at[]; } streams;
layout(set = 1, scalar) buffer ChosenBlock { Chosen at[]; } chosen;
// 16 pictures, one for each random number
layout(set = 1, scalar) buffer PermutedBlock { ivec2 at[]; } permuted;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < merges.at.length()) {
        Merge m = merges.at[i];
        DiReservoir first = DiReservoir(LightSample(1u, 0u, 0u), m.confidences.x, m.weights.x);
        DiReservoir second = DiReservoir(LightSample(2u, 0u, 0u), m.confidences.y, m.weights.y);
        DiReservoir result = merge_di_reservoirs(first, second, m.here, m.there, m.rng);
        merged.at[i] = Merged(result.light_sample.light_index, result.confidence, result.unbiased_contribution_weight);
    }
    if (i < streams.at.length()) {
        Stream s = streams.at[i];
        chosen.at[i] = Chosen(NO_INDEX, 0.0);
        for (uint k = 0u; k < 4u; k++) {
            if (choose_weighted(chosen.at[i].sum, s.weights[k], s.rng)) { chosen.at[i].index = k; }
        }
    }
    uint pixels = camera.size.x * camera.size.y;
    if (i < 16u * pixels) {
        ivec2 pixel = ivec2(i % pixels % camera.size.x, i % pixels / camera.size.x);
        permuted.at[i] = permute_pixel(pixel, i / pixels);
    }
}
