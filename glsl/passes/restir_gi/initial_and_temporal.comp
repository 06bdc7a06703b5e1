// ReSTIR GI (Ouyang et al., HPG 2021), first half: what one ray finds, merged with what a pixel of the last frame had.
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
    GiReservoir reservoir = empty_gi_reservoir(1.0);  // its normal says SEEN_IN_MIRROR
    vec3 direction = orthonormalize(surface.world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
    if (!(dot(direction, surface.geometric_world_normal) > 0.0)) { return reservoir; }
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    Gathered light =
        gather_light(origin, direction, INFINITY, 0.0, true, world_cache_settings.lifetime, rng);
    reservoir.sample_point_world_position = light.sight.first_position;
    reservoir.radiance = light.sight.emitted;
    if (light.sight.found) {
        if (light.sight.mirrors == 0u) { reservoir.sample_point_world_normal = light.sight.surface.geometric_world_normal; }
        reservoir.reflectance = light.reflectance;
        reservoir.radiance = gathered_radiance(light);
    }
    reservoir.unbiased_contribution_weight = gi_target(surface, reservoir) > 0.0 ? 2.0 * PI : 0.0;
    return reservoir;
}

// Differs from Solari, where what was found once stays until it is replaced: light that has gone would linger for as long
// as confidence lasts. A contribution weight serves any function of its point, so also a later frame's light.
void refresh_radiance(inout GiReservoir reservoir, GBufferSurface surface, inout uint rng) {
    bool mirrored = reservoir.sample_point_world_normal == SEEN_IN_MIRROR;
    if (restir_gi_settings.refresh == 0u || mirrored || !(reservoir.unbiased_contribution_weight > 0.0)) { return; }
    float ray_t = distance(surface.world_position, reservoir.sample_point_world_position);
    WorldCacheResult cached = query_world_cache(
        reservoir.sample_point_world_position, reservoir.sample_point_world_normal, ray_t,
        world_cache_settings.lifetime, rng
    );
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
    uvec2 at;
    GBufferSurface before;
    if (restir_gi_settings.temporal != 0u && find_temporal_neighbor(pixel, surface, at, before)) {
        GiReservoir previous = previous_gi_reservoirs.at[at.y * camera.size.x + at.x];
        previous.confidence_weight = min(previous.confidence_weight, restir_gi_settings.confidence_cap);
        refresh_radiance(previous, surface, rng);
        before.ray_offset = surface.ray_offset;  // not kept of the last frame
        bool retest = restir_gi_settings.visibility == GI_VISIBILITY_BOTH;
        reservoir = merge_gi_reservoirs(surface, reservoir, before, previous, retest, rand_f(rng));
    }
    gi_temporal_reservoirs.at[index] = reservoir;
}
