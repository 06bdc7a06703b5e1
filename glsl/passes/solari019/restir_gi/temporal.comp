// ReSTIR GI, temporal reuse: merges a pixel's initial sample with the reservoir of a pixel of the previous frame.
// Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (HPG 2021). A pass of its own, because few
// values live while a pass traces a ray makes rays fast on a GPU.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/solari019/restir_gi/reservoir.glsl"
#include "passes/reuse.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x3C6EF372u;

// Replaces a sample's radiance by what its point reflects in this frame. Differs from Solari, where a sample keeps
// its radiance, so that light stays visible after it was switched off. A contribution weight is valid for any
// function of the sample point, and so for the light of a later frame too. A cell dies unless it is read every frame,
// so a sample forgets a cell that it doesn't read here.
void refresh_radiance(inout GiReservoir reservoir) {
    bool refreshes = restir_gi_settings.refresh != 0u && frame_settings.world_cache != 0u;
    if (!refreshes) { reservoir.world_cache_cell = NO_INDEX; }
    if (reservoir.world_cache_cell == NO_INDEX || !(reservoir.unbiased_contribution_weight > 0.0)) { return; }
    WorldCacheResult cached = read_world_cache_cell(reservoir.world_cache_cell, world_cache_settings.lifetime);
    if (cached.found) { reservoir.radiance = reservoir.reflectance * cached.irradiance; }
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    GiReservoir reservoir = gi_temporal_reservoirs.at[index];
    if (reservoir.confidence_weight == 0.0 || restir_gi_settings.temporal == 0u) { return; }

    GBufferSurface surface = load_gbuffer(pixel);
    uvec2 neighbor;
    GBufferSurface neighbor_surface;
    if (!find_temporal_neighbor(pixel, surface, neighbor, neighbor_surface)) { return; }
    neighbor_surface.ray_offset = surface.ray_offset;  // the previous G-buffer has none
    GiReservoir previous = gi_reservoirs.at[pixel_index(neighbor, camera.size)];
    previous.confidence_weight = min(previous.confidence_weight, restir_gi_settings.confidence_cap)
        * (1.0 - this_frame.lighting_change);
    refresh_radiance(previous);
    bool retest = restir_gi_settings.visibility == GI_VISIBILITY_BOTH;
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    GiMerge merged = merge_gi_reservoirs(surface, reservoir, neighbor_surface, previous, retest, rand_f(rng));
    if (merged.other_chosen) { reservoir = previous; }
    gi_temporal_reservoirs.at[index] = apply_merge(merged, reservoir);
}
