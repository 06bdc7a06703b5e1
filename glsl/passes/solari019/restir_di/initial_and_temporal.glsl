// ReSTIR DI, first half: chooses one of several light samples by their unshadowed light, and merges it with the
// reservoir of a pixel of the previous frame. Bitterli et al., "Spatiotemporal Reservoir Resampling for Real-Time Ray
// Tracing with Dynamic Direct Lighting" (2020).
#ifndef PASSES_SOLARI019_RESTIR_DI_INITIAL_AND_TEMPORAL_GLSL
#define PASSES_SOLARI019_RESTIR_DI_INITIAL_AND_TEMPORAL_GLSL

#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/solari019/light_tiles/light_tiles.glsl"
#include "passes/solari019/restir_di/bindings.glsl"
#include "passes/solari019/restir_di/target.glsl"
#include "passes/reuse.glsl"

const uint PASS_SALT = 0x2C1B3C6Du;
const uint TILE_SALT = 0x297A2D39u;

// Resampled importance sampling. Weights are computed from packed light samples, since they only decide which one is
// chosen.
DiReservoir generate_initial_reservoir(uvec2 pixel, GBufferSurface surface, inout uint rng) {
    uint group_rng = seed_rng(pixel / 8u, this_frame.index, this_frame.seed ^ TILE_SALT);
    uint tile = choose_light_tile(group_rng);
    DiReservoir reservoir = EMPTY_DI_RESERVOIR;
    float weight_sum = 0.0, chosen_weight = 0.0;
    for (uint i = 0u; i < restir_di_settings.candidates; i++) {
        LightCandidate candidate = sample_light_candidate(tile, rng);
        float weight = di_weight(surface, candidate.resolved);
        if (choose_weighted(weight_sum, weight, rng)) {
            reservoir.light_sample = candidate.light_sample;
            chosen_weight = weight;
        }
    }
    reservoir.confidence = 1.0;
    if (!(chosen_weight > 0.0)) { return reservoir; }
    float target = di_target(chosen_weight, reservoir.light_sample);
    float mean = weight_sum / float(restir_di_settings.candidates);
    reservoir.unbiased_contribution_weight = target > 0.0 ? mean / target : 0.0;
    return reservoir;
}

// A reservoir of the previous frame, with the light's index in this frame. A reservoir whose light was removed keeps
// its confidence; otherwise those that found a remaining light would count too much. While lights change, all have less
// confidence: where most of the light is gone, few reservoirs found what remains, so that the mean of many pixels is
// noisy.
DiReservoir load_previous_reservoir(uvec2 pixel) {
    DiReservoir reservoir = di_reservoirs.at[pixel_index(pixel, camera.size)];
    reservoir.confidence = min(reservoir.confidence, restir_di_settings.confidence_cap)
        * (1.0 - this_frame.lighting_change);
    if (reservoir.light_sample.light_index != NO_INDEX) {
        reservoir.light_sample.light_index = light_translation.at[reservoir.light_sample.light_index];
    }
    return reservoir;
}

DiReservoir merge_with_previous(uvec2 pixel, GBufferSurface surface, DiReservoir reservoir, inout uint rng) {
    uvec2 neighbor;
    GBufferSurface neighbor_surface;
    if (restir_di_settings.temporal == 0u || !find_temporal_neighbor(pixel, surface, neighbor, neighbor_surface)) {
        return reservoir;
    }
    DiReservoir previous = load_previous_reservoir(neighbor);
    vec2 here = vec2(di_target(surface, reservoir), di_target(surface, previous));
    vec2 there = vec2(
        previous_di_target(neighbor_surface, reservoir), previous_di_target(neighbor_surface, previous)
    );
    return merge_di_reservoirs(reservoir, previous, here, there, rng);
}

// Each entry point says what happens to a chosen sample whose light is occluded.
void test_visibility(GBufferSurface surface, inout DiReservoir reservoir);

void write_temporal_reservoir(uvec2 pixel) {
    GBufferSurface surface = load_gbuffer(pixel);
    DiReservoir reservoir = EMPTY_DI_RESERVOIR;
    if (surface.exists && solari019_settings.di != 0u) {
        uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
        reservoir = generate_initial_reservoir(pixel, surface, rng);
        test_visibility(surface, reservoir);
        reservoir = merge_with_previous(pixel, surface, reservoir, rng);
    }
    di_temporal_reservoirs.at[pixel_index(pixel, camera.size)] = reservoir;
}

#endif
