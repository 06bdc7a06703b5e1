// Reuse between frames: chooses one of the two candidates of a pixel's path, and merges it with the reservoir of a
// pixel of the previous frame. Lin et al., "Generalized Resampled Importance Sampling" (2022).
#version 460
#include "common/pixel.glsl"
#include "passes/paths/reservoir.glsl"
#include "passes/reuse.glsl"  // and passes/bindings.glsl: light_translation, previous_light

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x9E1C5A37u;

// A weight above 0 tells evaluate_target that there is a candidate; the result's own weight is set last.
PathReservoir choose_candidate(ReservoirCandidate candidate, Vertex vertex, float choice) {
    PathReservoir light = PathReservoir(candidate.light, vec3(0.0), 1.0, candidate.light_resampling_weight, NO_INDEX);
    uvec4 point = uvec4(floatBitsToUint(candidate.position), candidate.normal);
    PathReservoir hit = PathReservoir(point, candidate.radiance, 1.0, candidate.path_contribution_weight,
        candidate.instance);
    float light_target = evaluate_target(vertex, light).value, hit_target = evaluate_target(vertex, hit).value;
    float path_resampling_weight = hit_target * candidate.path_contribution_weight;
    float weight_sum = candidate.light_resampling_weight + path_resampling_weight;
    bool chooses_hit = choice * weight_sum < path_resampling_weight;
    PathReservoir chosen = chooses_hit ? hit : light;
    float target = chooses_hit ? hit_target : light_target;
    chosen.weight = target > 0.0 ? weight_sum / target : 0.0;
    return chosen;
}

// A reservoir of the previous frame, with the light's index in this frame. A reservoir whose light was removed becomes
// an empty sample with the same confidence: if it were dropped, only those with a remaining light would count, and the
// mean would be too bright. While lights change, all have less confidence: the radiance of path samples is out of date,
// and where most of the light is gone, few reservoirs found what remains, so that the mean of many pixels is noisy.
PathReservoir load_previous_reservoir(uvec2 pixel) {
    PathReservoir reservoir = paths_reservoirs.at[element_index(pixel, camera.size)];
    reservoir.confidence = min(reservoir.confidence, restir_settings.confidence_cap)
        * (1.0 - this_frame.lighting_change);
    if (!is_path_sample(reservoir) && reservoir.weight > 0.0) {
        reservoir.point.x = light_translation.at[reservoir.point.x];
        if (reservoir.point.x == NO_INDEX) { reservoir.weight = 0.0; }
    }
    return reservoir;
}

// The confidence of the previous frame in the MIS weight of a sample. It is 0 for a light that the previous frame
// didn't have, and for a path sample on a moving instance, whose position is out of date.
float previous_confidence(float confidence, PathReservoir reservoir) {
    if (is_path_sample(reservoir)) {
        return is_static(reservoir.instance) ? confidence : 0.0;
    }
    return reservoir.weight > 0.0 && previous_light.at[reservoir.point.x] == NO_INDEX ? 0.0 : confidence;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    uint index;
    if (!find_pixel(pixel, index)) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    PathReservoir reservoir = EMPTY_RESERVOIR;
    if (surface.exists) {
        uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
        Vertex vertex = make_vertex(dispersed(surface, pixel));
        reservoir = choose_candidate(paths_reservoir_candidates.at[index], vertex, rand_f(rng));
        uvec2 neighbor;
        GBufferSurface neighbor_surface;
        if (!is_dispersive(surface) && find_temporal_neighbor(pixel, surface, neighbor, neighbor_surface)
            && !(SCENE_DISPERSION && neighbor_surface.instance != surface.instance)) {
            neighbor_surface.ray_offset = surface.ray_offset;  // the previous G-buffer has none
            neighbor_surface.lift = surface.lift;
            PathReservoir previous = load_previous_reservoir(neighbor);
            vec2 confidence = vec2(
                previous_confidence(previous.confidence, reservoir), previous_confidence(previous.confidence, previous)
            );
            reservoir = merge_reservoirs(
                vertex, reservoir, make_vertex(neighbor_surface), previous, true, confidence, rand_f(rng)
            ).reservoir;
        }
    }
    paths_temporal_reservoirs.at[index] = reservoir;
}
