// Next event estimation: chooses a point of a light, resolves it, and computes what it sends to a point in the world.
// And its counterpart in MIS: the radiance of lights at infinity, and of pass-through lights, that a ray hits.
#ifndef SCENE_SAMPLING_GLSL
#define SCENE_SAMPLING_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
// Written by solari_vk/bound/lights/light_kinds.py: the numbers of kinds, LIGHT_*; sets of them, KINDS_*;
// HAS_PASS_THROUGH_LIGHTS; and functions that call that of a given kind. resolve_light makes the point of a light
// sample, evaluate_light and intersect_light what a ray finds of a light at infinity or of a pass-through light.
// emission_cosine is the cosine at the light, or 1. light_sample_for_receiver: a resolved sample as a receiver sees it,
// which differs between receivers for spheres, portals and others; shadow_sample_for_receiver: the same of a sample
// that for_shadow_ray has returned.
#include "generated/bound/lights/light_kinds.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/choice.glsl"
#include "scene/lights/portal_sampling.glsl"
#include "scene/lights/tree.glsl"
#include "scene/lights/types.glsl"
#include "scene/medium.glsl"

struct LightContribution {
    // Radiance times the geometry term without the receiver's cosine, cos / distance^2. To be multiplied by
    // inverse_area_pdf and by the BRDF with its cosine.
    vec3 radiance_in_area_measure;
    float inverse_area_pdf;
    vec3 wi;
    float distance;          // INFINITY for lights at infinity
    float solid_angle_pdf;   // of wi, for MIS with BRDF samples; differs from Solari, which mixes measures
};

bool is_at_infinity(uint kind) { return (KINDS_AT_INFINITY >> kind & 1u) != 0u; }
bool can_be_hit_by_rays(uint kind) { return (KINDS_HIT_BY_RAYS >> kind & 1u) != 0u; }

LightSample sample_leaf(uint index, inout uint rng) {
    LightLeaf leaf = light_leaves.at[index];
    uint part = choose_part(leaf, rng);
    return LightSample(leaf.light, part, split_rng(rng));
}

LightSample generate_random_light_sample(inout uint rng) { return sample_leaf(choose_leaf(rng), rng); }

// The probability that a light sample has this light and part.
float light_sample_probability(LightSample light_sample) {
    return choice_probability_by_power(light_sources.at[light_sample.light_index], light_sample.part);
}

// `leaf_probability`: with which the sample's leaf was chosen.
ResolvedLightSample resolve_light_sample(LightSample light_sample, float leaf_probability) {
    LightSource light = light_sources.at[light_sample.light_index];
    uint rng = light_sample.seed;
    vec2 u = rand_vec2f(rng);
    float probability = leaf_probability * part_of_leaf(light, light_sample.part).probability;
    // a sample of an earlier frame may be of a light that is dark now
    float inverse_probability = probability > 0.0 ? 1.0 / probability : 0.0;
    return resolve_light(light.kind, light.record_index, light_sample.part, u, inverse_probability);
}

// The same where leaves are chosen by power.
ResolvedLightSample resolve_light_sample(LightSample light_sample) {
    uint leaf = part_of_leaf(light_sources.at[light_sample.light_index], light_sample.part).leaf;
    return resolve_light_sample(light_sample, light_leaves.at[leaf].by_power.probability);
}

// What a light sample sends to a receiver without occlusion. A light at infinity is computed like a point at distance
// 1. Differs from Solari: the cosine at the light depends on its kind, since points and suns have no surface.
LightContribution calculate_resolved_light_contribution(ResolvedLightSample light_sample, vec3 world_position) {
    light_sample = light_sample_for_receiver(light_sample, world_position);
    vec3 origin = is_at_infinity(light_sample.kind) ? vec3(0.0) : world_position;
    vec3 to_light = light_sample.world_position - origin;
    vec3 wi = safe_normalize(to_light, vec3(0.0));
    float cosine = emission_cosine(light_sample.kind, light_sample.data, -dot(wi, light_sample.world_normal));
    // a receiver within the rounding error of the light's point gets nothing instead of infinity
    float distance_squared = max(dot(to_light, to_light), square(light_sample.ray_offset));
    float solid_angle_per_area = distance_squared > 0.0 ? cosine / distance_squared : 0.0;
    float inverse_solid_angle_pdf = solid_angle_per_area * light_sample.inverse_area_pdf;
    float solid_angle_pdf = inverse_solid_angle_pdf > 0.0 ? 1.0 / inverse_solid_angle_pdf : 0.0;
    return LightContribution(
        light_sample.radiance * solid_angle_per_area,
        light_sample.inverse_area_pdf,
        wi,
        is_at_infinity(light_sample.kind) ? INFINITY : sqrt(distance_squared),
        can_be_hit_by_rays(light_sample.kind) ? solid_angle_pdf : INFINITY
    );
}

// The radiance of a light that a ray hits, with its MIS weight against light samples, which choose the light with the
// probability `light_probability`. mis_pdf: Walk.mis_pdf.
vec3 mis_weighted_radiance(LightHit light_hit, float light_probability, float mis_pdf) {
    if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { return vec3(0.0); }
    float light_pdf = light_probability / light_hit.inverse_solid_angle_pdf;
    return light_hit.radiance * power_heuristic(mis_pdf, light_pdf);
}

// Prepares a light sample for its shadow ray. One at infinity becomes that of a directional light, which is the same
// for all receivers: its direction stays `wi`, that from the receiver, though the ray's origin is offset from there.
ResolvedLightSample for_shadow_ray(ResolvedLightSample light_sample, vec3 wi) {
    if (is_at_infinity(light_sample.kind)) {
        light_sample.kind = LIGHT_DIRECTIONAL;
        light_sample.world_position = wi;
    }
    return light_sample;
}

// The probability with which a receiver chooses a portal, over the portal's probability by power.
float portal_choice_ratio(uint index, Receiver receiver) {
    LightSource light = light_sources.at[portal_light(index)];
    return leaf_choice_probability(light.first_leaf, receiver) / light_probability_by_power(light);
}

// The probability with which a receiver chooses a light at infinity.
float choice_probability_at_infinity(LightSource light, Receiver receiver) {
    return LIGHT_STRATA ? leaf_choice_probability(light.first_leaf, receiver) : light_probability_by_power(light);
}

// Light samples of an environment come from several strategies: its map, and each portal. Its radiance is split among
// them by the balance heuristic (scene/lights/portal.glsl), and each share is a MIS problem of its own: a ray that hits
// the environment against light samples of that strategy, by the power heuristic. Returns the ray's weight for one
// strategy: the strategy's share times the power heuristic. strategy_pdf, pdf_sum: the pdfs of the strategy and of all
// together, with leaves chosen by power; choice_ratio: the probability with which the receiver chooses the strategy,
// over that by power.
float strategy_weight(float strategy_pdf, float choice_ratio, float pdf_sum, float mis_pdf) {
    float share = pdf_sum > 0.0 ? strategy_pdf / pdf_sum : 1.0;  // the sum is 0 for lights without power
    return share * power_heuristic(mis_pdf, choice_ratio * strategy_pdf);
}

// The radiance of an environment along a ray that leaves a receiver, with its MIS weight against samples of the map and
// of portals. Pdfs are those at the receiver's position, as for light samples, not at the ray's origin off the surface.
vec3 mis_weighted_environment(
    LightSource light, LightHit light_hit, vec3 direction, float mis_pdf, Receiver receiver
) {
    if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { return vec3(0.0); }
    float map_pdf = light_probability_by_power(light) / light_hit.inverse_solid_angle_pdf;
    float pdf_sum = map_pdf, through_portals = 0.0;
    for (uint i = scene_info.first_portal_record; i < portal_end(); i++) {
        float portal_pdf = evaluate_portal_pdf(i, receiver.position, direction);
        if (!(portal_pdf > 0.0)) { continue; }
        pdf_sum += portal_pdf;
        // with 1 for pdf_sum, which is known after the loop
        through_portals += strategy_weight(portal_pdf, portal_choice_ratio(i, receiver), 1.0, mis_pdf);
    }
    float by_power = light_probability_by_power(light);  // 0 for a dark one
    float choice_ratio = 1.0;
    if (LIGHT_STRATA && by_power > 0.0) { choice_ratio = choice_probability_at_infinity(light, receiver) / by_power; }
    float weight = strategy_weight(map_pdf, choice_ratio, pdf_sum, mis_pdf);
    return light_hit.radiance * (through_portals > 0.0 ? weight + through_portals / pdf_sum : weight);
}

// The radiance of all lights at infinity along a ray that hit no surface, with its MIS weight. `receiver`: for which
// the competing light samples were chosen.
vec3 mis_weighted_radiance_at_infinity(vec3 direction, float mis_pdf, Receiver receiver) {
    vec3 radiance = vec3(0.0);
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_end; i++) {
        LightSource light = light_sources.at[i];
        LightHit light_hit = evaluate_light(light.kind, light.record_index, direction);
        if (has_portals() && light.kind == LIGHT_ENVIRONMENT && mis_pdf != INFINITY) {
            radiance += mis_weighted_environment(light, light_hit, direction, mis_pdf, receiver);
        } else {
            float probability = choice_probability_at_infinity(light, receiver);
            radiance += mis_weighted_radiance(light_hit, probability, mis_pdf);
        }
    }
    return radiance;
}

// The same for pass-through lights on a ray, without the transmittance of surfaces before them.
vec3 mis_weighted_radiance_along_ray(vec3 origin, vec3 direction, float t_max, float mis_pdf, Medium medium) {
    vec3 radiance = vec3(0.0);
    if (!HAS_PASS_THROUGH_LIGHTS) { return radiance; }
    for (uint i = scene_info.first_pass_through_light; i < scene_info.first_light_at_infinity; i++) {
        LightSource light = light_sources.at[i];
        LightHit light_hit = intersect_light(light.kind, light.record_index, origin, direction, t_max);
        radiance += mis_weighted_radiance(light_hit, light_probability_by_power(light), mis_pdf)
            * transmittance(medium, light_hit.t);
    }
    return radiance;
}

#endif
