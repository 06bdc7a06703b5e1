// ReSTIR GI, second half: merges a pixel's reservoir with that of a neighbor, keeps the result for the next frame,
// and shades. Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (HPG 2021).
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/solari019/restir_gi/reservoir.glsl"
#include "passes/reuse.glsl"
#include "scene/brdf.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0xBB67AE85u;

vec3 shade_diffuse(GBufferSurface surface, GiReservoir reservoir) {
    if (!(reservoir.unbiased_contribution_weight > 0.0)) { return vec3(0.0); }
    mat3 frame = orthonormalize(surface.world_normal);
    vec3 wo = surface.wo * frame;
    vec3 wi = normalize(reservoir.sample_point_world_position - surface.world_position) * frame;
    return gi_radiance(surface, reservoir) * reservoir.unbiased_contribution_weight
        * evaluate_diffuse_brdf(prepare_brdf(surface.material, wo), wo, wi);
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    GBufferSurface surface = load_gbuffer(pixel);
    GiReservoir reservoir = gi_temporal_reservoirs.at[index];
    if (reservoir.confidence_weight > 0.0 && restir_gi_settings.spatial != 0u) {
        uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
        uvec2 neighbor;
        GBufferSurface neighbor_surface;
        if (find_spatial_neighbor(pixel, surface, restir_gi_settings.spatial_radius, rng, neighbor, neighbor_surface)) {
            uint neighbor_index = pixel_index(neighbor, camera.size);
            GiReservoir other = gi_temporal_reservoirs.at[neighbor_index];
            GiMerge merged = merge_gi_reservoirs(surface, reservoir, neighbor_surface, other, true, rand_f(rng));
            // loaded again, instead of kept across rays
            reservoir = apply_merge(merged, gi_temporal_reservoirs.at[merged.other_chosen ? neighbor_index : index]);
        }
    }
    if (SCENE_BLEND && reservoir.unbiased_contribution_weight > 0.0) {
        reservoir.transmittance = pack_rgb9e5(trace_sample_transmittance(surface, reservoir));
    }
    gi_reservoirs.at[index] = reservoir;
    gi_diffuse.at[index] = shade_diffuse(load_gbuffer(pixel), reservoir);
}
