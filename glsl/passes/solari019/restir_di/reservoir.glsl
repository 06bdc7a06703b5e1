// A reservoir of direct light and the merge of two: Bitterli et al., "Spatiotemporal Reservoir Resampling for
// Real-Time Ray Tracing with Dynamic Direct Lighting" (2020), with the weights of Lin et al., "Generalized Resampled
// Importance Sampling" (2022).
//
// Differs from Solari: densities are over lights, their parts and the random numbers in a part, not over area. Lights
// and parts are counted, whatever their probability, and targets are in the same measure: the light that a sample adds,
// divided by the density of its point in its part. A sample's weight, an estimate of 1 / density, thus stays valid in
// later frames when its light grows, shrinks or turns, and when lights become more or less likely. What had the
// probability 0 is the exception, because no earlier frame could find it: light_list.py gives a light that
// was dark a new id, and triangles have the probability 0 only where their whole light is dark.
#ifndef PASSES_SOLARI019_RESTIR_DI_RESERVOIR_GLSL
#define PASSES_SOLARI019_RESTIR_DI_RESERVOIR_GLSL

#include "common/random.glsl"
#include "scene/sampling.glsl"

struct DiReservoir {
    LightSample light_sample;          // light_index NO_INDEX: empty
    float confidence;                  // in frames; empty reservoirs have it too
    float unbiased_contribution_weight;  // an estimate of 1 / pdf over lights and parts
};

const DiReservoir EMPTY_DI_RESERVOIR = DiReservoir(LightSample(NO_INDEX, 0u, 0u), 0.0, 0.0);

// The MIS weight of a sample of the first of two reservoirs; `targets` are the sample's targets at the two pixels.
float merge_share(vec2 confidences, vec2 targets) {
    vec2 weights = confidences * targets;
    return weights.x > 0.0 ? weights.x / (weights.x + weights.y) : 0.0;
}

// Merges a pixel's reservoir with that of another pixel. `here` are the targets of both samples at this pixel,
// `there` those at the other one. The result is unbiased as long as the first reservoir can find each sample whose
// target here isn't 0.
DiReservoir merge_di_reservoirs(DiReservoir first, DiReservoir second, vec2 here, vec2 there, inout uint rng) {
    vec2 confidences = vec2(first.confidence, second.confidence);
    float first_share = merge_share(confidences, vec2(here.x, there.x));
    float second_share = merge_share(confidences.yx, vec2(there.y, here.y));

    DiReservoir merged = EMPTY_DI_RESERVOIR;
    float weight_sum = 0.0, target = 0.0;
    if (choose_weighted(weight_sum, first_share * here.x * first.unbiased_contribution_weight, rng)) {
        merged.light_sample = first.light_sample;
        target = here.x;
    }
    if (choose_weighted(weight_sum, second_share * here.y * second.unbiased_contribution_weight, rng)) {
        merged.light_sample = second.light_sample;
        target = here.y;
    }
    merged.confidence = first.confidence + second.confidence;
    merged.unbiased_contribution_weight = target > 0.0 ? weight_sum / target : 0.0;
    return merged;
}

#endif
