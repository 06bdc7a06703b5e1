// ReSTIR DI, second half: merges a pixel's reservoir with that of a neighbor, keeps the result for the next frame,
// and only then tests whether the chosen light is visible, and shades. Bitterli et al., "Spatiotemporal Reservoir
// Resampling for Real-Time Ray Tracing with Dynamic Direct Lighting" (2020).
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/camera_medium.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/ray_count.glsl"
#include "passes/solari019/restir_di/bindings.glsl"
#include "passes/solari019/restir_di/target.glsl"
#include "passes/reuse.glsl"
#include "scene/brdf.glsl"
#include "scene/walk.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0xB5297A4Du;

vec3 transmittance(GBufferSurface surface, ResolvedLightSample resolved) {
    count_ray();
    vec3 origin = surface.world_position + surface.geometric_world_normal * surface.ray_offset;
    return trace_shadow_ray(origin, camera_medium(), resolved);
}

// Returns the index of the neighbor, or NO_INDEX when no tried pixel is similar.
uint merge_with_neighbor(uvec2 pixel, GBufferSurface surface, inout DiReservoir reservoir) {
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    uvec2 neighbor;
    GBufferSurface neighbor_surface;
    if (!find_spatial_neighbor(pixel, surface, restir_di_settings.spatial_radius, rng, neighbor, neighbor_surface)) {
        return NO_INDEX;
    }
    uint neighbor_index = pixel_index(neighbor, camera.size);
    DiReservoir other = di_temporal_reservoirs.at[neighbor_index];
    vec2 here = vec2(di_target(surface, reservoir), di_target(surface, other));
    vec2 there = vec2(di_target(neighbor_surface, reservoir), di_target(neighbor_surface, other));
    reservoir = merge_di_reservoirs(reservoir, other, here, there, rng);
    return neighbor_index;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    GBufferSurface surface = load_gbuffer(pixel);
    DiReservoir reservoir = di_temporal_reservoirs.at[index];
    uvec2 outcome = uvec2(NO_INDEX, 0u);
    if (surface.exists && solari019_settings.di != 0u && restir_di_settings.spatial != 0u) {
        outcome.x = merge_with_neighbor(pixel, surface, reservoir);
    }
    di_reservoirs.at[index] = reservoir;

    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    if (reservoir.unbiased_contribution_weight > 0.0) {
        ResolvedLightSample resolved = resolve_light_sample(reservoir.light_sample);
        LightContribution light = calculate_resolved_light_contribution(resolved, surface.world_position);
        mat3 frame = orthonormalize(surface.world_normal);
        vec3 wo = surface.wo * frame, wi = light.wi * frame;
        Brdf brdf = prepare_brdf(surface.material, wo);
        float inverse_point_pdf = light.inverse_area_pdf * light_sample_probability(reservoir.light_sample);
        vec3 received = light.radiance_in_area_measure * (inverse_point_pdf * reservoir.unbiased_contribution_weight);
        diffuse = received * evaluate_diffuse_brdf(brdf, wo, wi);
        if (di_shades_specular(surface.material, resolved.kind)) {
            specular = received * evaluate_specular_brdf(brdf, wo, wi);
        }
        // last, when the surface isn't needed any more
        vec3 arriving = transmittance(surface, for_shadow_ray(resolved, light.wi));
        outcome.y = arriving != vec3(0.0) ? 1u : 0u;
        diffuse *= arriving;
        specular *= arriving;
    }
    di_diffuse.at[index] = diffuse;
    di_specular.at[index] = specular;
    di_outcomes.at[index] = outcome;
}
