// World cache, step 4: direct light of active cells, by resampled importance sampling (Talbot et al., "Importance
// Resampling for Global Illumination", 2005) over light samples, and one shadow ray to the chosen one. Differs from
// Solari, where the cells of a workgroup share a tile, so that their errors are correlated: each cell chooses a tile.
#version 460
#include "passes/solari019/light_tiles/light_tiles.glsl"
#include "passes/ray_count.glsl"
#include "passes/world_cache/division.glsl"
#include "passes/world_cache/update.glsl"
#include "scene/walk.glsl"

layout(local_size_x = GROUP_SIZE) in;

const uint PASS_SALT = 0x7C0D14ECu;

vec3 sample_direct_irradiance(WorldCacheSurface surface, inout uint rng) {
    uint tile = choose_light_tile(rng);
    float weight_sum = 0.0;
    float chosen_target = 0.0;
    LightSample chosen;
    for (uint i = 0u; i < world_cache_settings.candidates; i++) {
        LightCandidate candidate = sample_light_candidate(tile, rng);
        LightContribution light = calculate_resolved_light_contribution(candidate.resolved, surface.world_position);
        float target = luminance(light.radiance_in_area_measure) * max(dot(light.wi, surface.geometric_world_normal),
            0.0);
        if (choose_weighted(weight_sum, target * light.inverse_area_pdf, rng)) {
            chosen = candidate.light_sample;
            chosen_target = target;
        }
    }
    if (!(chosen_target > 0.0)) { return vec3(0.0); }

    ResolvedLightSample light_sample = resolve_light_sample(chosen);
    LightContribution light = calculate_resolved_light_contribution(light_sample, surface.world_position);
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    count_ray();
    vec3 transmittance = trace_shadow_ray(origin, find_medium(origin), for_shadow_ray(light_sample, light.wi));
    float cosine = max(dot(light.wi, surface.geometric_world_normal), 0.0);
    float inverse_pdf = weight_sum / (float(world_cache_settings.candidates) * chosen_target);
    return light.radiance_in_area_measure * (cosine * inverse_pdf) * transmittance;
}

void main() {
    uint thread = thread_index(INVOCATION_INDEX);
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    atomicAdd(world_cache_counters.updates, 1u);
    uint rng = seed_cell_rng(cell, PASS_SALT);
    vec3 irradiance = sample_direct_irradiance(load_world_cache_surface(cell), rng);
    world_cache_samples.at[thread].irradiance = irradiance;
    test_for_wall(cell, thread);
}
