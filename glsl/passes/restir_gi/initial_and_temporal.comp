// ReSTIR GI, first half: traces one ray for a new sample, and merges it with the reservoir of a pixel of the previous
// frame. Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (HPG 2021).
#version 460
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/restir_gi/reservoir.glsl"
#include "passes/reuse.glsl"
#include "passes/world_cache/query.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x6A09E667u;

GiReservoir generate_initial_reservoir(GBufferSurface surface, inout uint rng) {
    GiReservoir reservoir = empty_gi_reservoir(1.0);  // its normal is SEEN_IN_MIRROR
    vec3 direction = orthonormalize(surface.world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
    if (!(dot(direction, surface.geometric_world_normal) > 0.0)) { return reservoir; }
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    GatheredLight light = gather_light(origin, direction, INFINITY, 0.0, true, world_cache_settings.lifetime, rng);
    HitPastMirrors first = light.first;
    reservoir.sample_point_world_position = first.first_position;
    reservoir.radiance = first.emitted;
    if (first.exists) {
        if (first.mirror_count == 0u) {
            reservoir.sample_point_world_normal = first.surface.geometric_world_normal;
            reservoir.world_cache_cell = light.cell;
        }
        reservoir.reflectance = light.reflectance;
        reservoir.radiance = gathered_radiance(light);
    }
    reservoir.unbiased_contribution_weight = gi_target(surface, reservoir) > 0.0 ? 2.0 * PI : 0.0;
    return reservoir;
}

// Replaces a sample's radiance by what its point reflects in this frame. Differs from Solari, where a sample keeps
// its radiance, so that light stays visible after it was switched off. A contribution weight is valid for any
// function of the sample point, and so for the light of a later frame too. A cell that isn't read in a frame is lost.
void refresh_radiance(inout GiReservoir reservoir) {
    bool refreshes = restir_gi_settings.refresh != 0u && frame_settings.world_cache != 0u;
    if (!refreshes) { reservoir.world_cache_cell = NO_INDEX; }
    if (reservoir.world_cache_cell == NO_INDEX || !(reservoir.unbiased_contribution_weight > 0.0)) { return; }
    WorldCacheResult cached = read_world_cache_cell(reservoir.world_cache_cell, world_cache_settings.lifetime);
    if (cached.found) { reservoir.radiance = reservoir.reflectance * cached.irradiance; }
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    uint index = pixel.y * camera.size.x + pixel.x;
    GBufferSurface surface = load_gbuffer(pixel);
    if (takes_no_gi(surface)) {
        gi_temporal_reservoirs.at[index] = empty_gi_reservoir(0.0);
        return;
    }

    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    GiReservoir reservoir = generate_initial_reservoir(surface, rng);
    uvec2 neighbor;
    GBufferSurface neighbor_surface;
    if (restir_gi_settings.temporal != 0u && find_temporal_neighbor(pixel, surface, neighbor, neighbor_surface)) {
        GiReservoir previous = previous_gi_reservoirs.at[neighbor.y * camera.size.x + neighbor.x];
        previous.confidence_weight = min(previous.confidence_weight, restir_gi_settings.confidence_cap);
        refresh_radiance(previous);
        neighbor_surface.ray_offset = surface.ray_offset;  // the previous G-buffer has none
        bool retest = restir_gi_settings.visibility == GI_VISIBILITY_BOTH;
        reservoir = merge_gi_reservoirs(surface, reservoir, neighbor_surface, previous, retest, rand_f(rng));
    }
    gi_temporal_reservoirs.at[index] = reservoir;
}
