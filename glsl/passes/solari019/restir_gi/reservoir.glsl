// Reuse of indirect light between pixels by reconnection to the same point: Ouyang et al., "ReSTIR GI: Path
// Resampling for Real-Time Path Tracing" (HPG 2021), weighted as in Lin et al., "Generalized Resampled Importance
// Sampling" (2022).
#ifndef PASSES_SOLARI019_RESTIR_GI_RESERVOIR_GLSL
#define PASSES_SOLARI019_RESTIR_GI_RESERVOIR_GLSL

#include "common/math.glsl"
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/camera_medium.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/ray_count.glsl"
#include "passes/solari019/restir_gi/bindings.glsl"
#include "scene/trace.glsl"

GiReservoir empty_gi_reservoir(float confidence_weight) {
    return GiReservoir(vec3(0.0), NO_INDEX, SEEN_IN_MIRROR, confidence_weight, vec3(0.0), 0.0, vec3(0.0), 0u);
}

// The reservoir that shades the pixel in this frame. Its sample is visible from the pixel, except with
// gi_visibility=neighbor, which tests samples of spatial neighbors only: a temporal sample may be hidden by now.
GiReservoir load_gi_reservoir(uvec2 pixel) { return gi_reservoirs.at[pixel_index(pixel, camera.size)]; }

// The light of a reservoir's sample that reaches the pixel which shades with it.
vec3 gi_radiance(GBufferSurface surface, GiReservoir reservoir) {
    vec3 radiance = reservoir.radiance;
    if (SCENE_BLEND) { radiance *= unpack_rgb9e5(reservoir.transmittance); }
    float away = distance(surface.world_position, reservoir.sample_point_world_position);
    return radiance * transmittance(camera_medium(), away);
}

// Whether the pixel needs no reservoir: its surface has no diffuse lobe, and is too smooth to reuse the reservoir for
// its specular lobe.
bool takes_no_gi(GBufferSurface surface) {
    bool smooth_metal = surface.material.base.metallic > frame_settings.pure_metal
        && surface.material.base.roughness <= specular_gi_settings.reuse_roughness;
    return !surface.exists || solari019_settings.gi == 0u
        || (restir_gi_settings.skip_smooth_metals != 0u && smooth_metal);
}

// The cosine of the direction to a point with the shading normal; 0 below the surface.
float gi_cosine(GBufferSurface surface, vec3 point) {
    vec3 wi = safe_normalize(point - surface.world_position, vec3(0.0));
    return dot(wi, surface.geometric_world_normal) > 0.0 ? max(dot(wi, surface.world_normal), 0.0) : 0.0;
}

// The target function of resampling. Differs from Solari, which multiplies by the albedo: without it, texture has no
// influence on which sample is chosen.
float gi_target(GBufferSurface surface, GiReservoir reservoir) {
    return luminance(reservoir.radiance) * gi_cosine(surface, reservoir.sample_point_world_position);
}

// The Jacobian of the reconnection shift: the solid angle of a piece of the sample's surface seen from `to`, over
// that seen from `from`. 0 when the shift is refused, because the sample's surface faces away or the ratio exceeds
// the limit. A shift is refused in both directions or in none.
float reconnection_jacobian(GBufferSurface from, GBufferSurface to, GiReservoir reservoir) {
    vec3 to_from = from.world_position - reservoir.sample_point_world_position;
    vec3 to_to = to.world_position - reservoir.sample_point_world_position;
    float from_cosine = dot(normalize(to_from), reservoir.sample_point_world_normal);
    float to_cosine = dot(normalize(to_to), reservoir.sample_point_world_normal);
    if (!(from_cosine > 0.0 && to_cosine > 0.0)) { return 0.0; }
    float jacobian = to_cosine / from_cosine * (dot(to_from, to_from) / dot(to_to, to_to));
    return max(jacobian, 1.0 / jacobian) <= restir_gi_settings.jacobian_limit ? jacobian : 0.0;
}

// The MIS weight (generalized balance heuristic) of a sample that `own` found and that `other` could have found too.
// The sample's radiance is the same for both and cancels.
float gi_mis_weight(GBufferSurface own, GiReservoir reservoir, GBufferSurface other, float other_confidence_weight) {
    vec3 point = reservoir.sample_point_world_position;
    return balance_heuristic(
        reservoir.confidence_weight * gi_cosine(own, point),
        other_confidence_weight * gi_cosine(other, point) * reconnection_jacobian(own, other, reservoir)
    );
}

vec3 trace_sample_transmittance(GBufferSurface surface, GiReservoir reservoir) {
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    vec3 segment = reservoir.sample_point_world_position - origin;
    // The ray ends before the point by the rounding error of a ray of this length.
    vec3 end = segment + reservoir.sample_point_world_normal * (16.0 * ROUNDING_UNIT * max_component(abs(segment)));
    count_ray();
    return trace_transmittance(origin, end, 1.0);
}

bool trace_sample_visibility(GBufferSurface surface, GiReservoir reservoir) {
    return trace_sample_transmittance(surface, reservoir) != vec3(0.0);
}

// Whose sample a merge keeps, and its new weights.
struct GiMerge {
    bool other_chosen;
    float confidence_weight;
    float unbiased_contribution_weight;
};

// Merges the reservoir of another pixel into that of this pixel. `choice` is a random number in [0, 1). With
// `retest`, the other pixel's sample counts only if it is visible from this pixel.
//
// MIS weights and the choice use targets without visibility. Differs from Solari (gi_visibility=neighbor), where a
// sample that the other pixel can't see keeps a weight below 1, which loses light at the edges of indirect shadows:
// here such a sample, when it is chosen, is divided by its weight, since only this pixel could have found it.
GiMerge merge_gi_reservoirs(
    GBufferSurface surface, GiReservoir own, GBufferSurface other_surface, GiReservoir other, bool retest, float choice
) {
    GiMerge merged = GiMerge(false, own.confidence_weight, own.unbiased_contribution_weight);
    if (other.confidence_weight == 0.0) { return merged; }
    merged.confidence_weight += other.confidence_weight;
    float own_target = gi_target(surface, own), other_target = gi_target(surface, other);
    float own_share = 1.0, own_weight = 0.0, other_weight = 0.0;
    if (own.unbiased_contribution_weight > 0.0) {
        own_share = gi_mis_weight(surface, own, other_surface, other.confidence_weight);
        own_weight = own_share * own_target * own.unbiased_contribution_weight;
    }
    if (other.unbiased_contribution_weight > 0.0) {
        float jacobian = reconnection_jacobian(other_surface, surface, other);
        other_weight = gi_mis_weight(other_surface, other, surface, own.confidence_weight)
            * other_target * jacobian * other.unbiased_contribution_weight;
        if (other_weight > 0.0 && retest && !trace_sample_visibility(surface, other)) { other_weight = 0.0; }
    }

    float weight_sum = own_weight + other_weight;
    merged.other_chosen = choice * weight_sum < other_weight;
    float target = merged.other_chosen ? other_target : own_target;
    merged.unbiased_contribution_weight = weight_sum > 0.0 ? weight_sum / target : 0.0;
    if (merged.other_chosen || own_weight == 0.0 || own_share == 1.0) { return merged; }
    if (restir_gi_settings.visibility == GI_VISIBILITY_BOTH && !trace_sample_visibility(other_surface, own)) {
        merged.unbiased_contribution_weight /= own_share;
    }
    return merged;
}

// The reservoir with the sample that a merge keeps.
GiReservoir apply_merge(GiMerge merged, GiReservoir chosen) {
    chosen.confidence_weight = merged.confidence_weight;
    chosen.unbiased_contribution_weight = merged.unbiased_contribution_weight;
    return chosen;
}

#endif
