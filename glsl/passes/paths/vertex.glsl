// A vertex of a path: a surface point seen from a direction, and the light that reaches it from lights.
#ifndef PASSES_PATHS_VERTEX_GLSL
#define PASSES_PATHS_VERTEX_GLSL

#include "passes/bindings.glsl"
#include "passes/paths/per_lobe.glsl"
#include "passes/ray_count.glsl"
#include "scene/walk.glsl"

struct Vertex {
    vec3 position;
    vec3 geometric_normal;  // faces the direction from which the vertex is seen
    vec3 origin;            // of rays that leave the vertex
    mat3 frame;             // its z axis is the shading normal
    vec3 wo;                // in that frame
    Brdf brdf;
};

// A vertex without its BRDF. `wo` is in world space.
Vertex make_vertex(vec3 position, vec3 geometric_normal, float ray_offset, vec3 shading_normal, vec3 wo) {
    Vertex vertex;
    vertex.position = position;
    vertex.geometric_normal = geometric_normal;
    vertex.origin = position + ray_offset * geometric_normal;
    vertex.frame = orthonormalize(shading_normal);
    vertex.wo = wo * vertex.frame;
    return vertex;
}

// Where rays that go in a direction leave the vertex.
vec3 ray_origin(Vertex vertex, vec3 direction) {
    bool transmits = SCENE_TRANSMISSION && dot(direction, vertex.geometric_normal) < 0.0;
    return transmits ? 2.0 * vertex.position - vertex.origin : vertex.origin;
}

// BRDF times cosine, by lobe.
PerLobe lobes_times_cosine(Vertex vertex, vec3 wi) {
    return PerLobe(
        evaluate_diffuse_brdf(vertex.brdf, vertex.wo, wi), evaluate_specular_brdf(vertex.brdf, vertex.wo, wi)
    );
}

// Makes surfaces rougher that a path reaches after a non-delta bounce. Otherwise few paths would find caustics, each
// far too bright. Kaplanyan and Dachsbacher, "Path Space Regularization for Holistic and Robust Light Transport"
// (2013).
void regularize(inout ResolvedMaterial material, float sum_of_inverse_pdfs) {
    float min_roughness = min(1.0, 0.5 * sqrt(sum_of_inverse_pdfs)) * paths_settings.regularization;
    if (SCENE_LAYERS) {
        material.coat.perceptual_roughness = max(material.coat.perceptual_roughness, sqrt(min_roughness));
    }
    if (material.base.roughness >= min_roughness) { return; }
    material.base.roughness = min_roughness;
    material.base.perceptual_roughness = sqrt(min_roughness);
}

// ---- light samples -----------------------------------------------------------------------------------

// What a vertex reflects of a light sample without occlusion, over the sample's pdf, with its MIS weight against BRDF
// samples. `expected_candidates`: n of light samples in Veach's multi-sample model, the expected number of RIS
// candidates for each BRDF sample.
PerLobe evaluate_next_event(Vertex vertex, LightContribution light, float expected_candidates) {
    vec3 wi = light.wi * vertex.frame;
    if (!is_on_valid_side(wi.z, light.wi, vertex.geometric_normal)) { return NO_LIGHT; }
    float light_pdf = expected_candidates * light.solid_angle_pdf;
    float mis_weight = power_heuristic(light_pdf, brdf_pdf(vertex.brdf, vertex.wo, wi));
    return scale(lobes_times_cosine(vertex, wi), light.radiance_in_area_measure * mis_weight * light.inverse_area_pdf);
}

// A light sample before its shadow ray.
struct RisLightSample {
    LightSample light_sample;
    ResolvedLightSample resolved;  // for its shadow ray
    vec3 wi;               // towards the light
    PerLobe contribution;  // what the vertex reflects unless the sample is occluded; 0: no shadow ray is needed
};

Receiver receiver(Vertex vertex) { return Receiver(vertex.position, vertex.frame[2]); }

// One of a stream of light samples, by the luminance that the vertex reflects of each.
struct RisReservoir {
    RisLightSample kept;
    float kept_weight;
    float weight_sum;
};

void add_to_reservoir(inout RisReservoir reservoir, RisLightSample added, inout uint rng) {
    float weight = luminance(sum(added.contribution));
    if (choose_weighted(reservoir.weight_sum, weight, rng)) {
        reservoir.kept = added;
        reservoir.kept_weight = weight;
    }
}

// Whether a light sample comes from infinity past all portals, so that it is occluded if the vertex is in a room.
bool comes_past_portals(ResolvedLightSample light_sample, vec3 receiver, vec3 direction) {
    if (!has_portals() || light_sample.kind == LIGHT_PORTAL || !is_at_infinity(light_sample.kind)) { return false; }
    return !passes_a_portal(receiver, direction);
}

// Resampled importance sampling (Talbot et al., "Importance Resampling for Global Illumination", 2005) of lights. The
// target function is the unoccluded luminance that the vertex reflects. Samples that come past portals are occluded if
// the vertex is in a room. Whether it is isn't known, so they have their own reservoir, which is taken with a
// probability of at most 1/2: none has less than half of the samples that it would have if that were known.
RisLightSample sample_light_by_ris(Vertex vertex, uint candidates, float expected_candidates, inout uint rng) {
    RisReservoir reservoir, past_portals;
    reservoir.kept.contribution = NO_LIGHT;
    reservoir.kept_weight = reservoir.weight_sum = 0.0;
    past_portals = reservoir;
    for (uint i = 0u; i < candidates; i++) {
        ChosenLeaf chosen = choose_leaf(receiver(vertex), rng);
        LightSample light_sample = sample_leaf(chosen.leaf, rng);
        ResolvedLightSample resolved = resolve_light_sample(light_sample, chosen.probability);
        LightContribution light = calculate_resolved_light_contribution(resolved, vertex.position);
        RisLightSample ris_sample = RisLightSample(
            light_sample, for_shadow_ray(resolved, light.wi), light.wi,
            evaluate_next_event(vertex, light, expected_candidates)
        );
        if (comes_past_portals(resolved, vertex.position, light.wi)) {
            add_to_reservoir(past_portals, ris_sample, rng);
        } else {
            add_to_reservoir(reservoir, ris_sample, rng);
        }
    }
    float probability = 1.0;
    if (SCENE_PORTAL && past_portals.weight_sum > 0.0) {
        float past = past_portals.weight_sum / (past_portals.weight_sum + reservoir.weight_sum);
        past = reservoir.weight_sum > 0.0 ? min(past, 0.5) : 1.0;
        bool takes_past = rand_f(rng) < past;
        probability = takes_past ? past : 1.0 - past;
        if (takes_past) { reservoir = past_portals; }
    }
    float ris_weight = reservoir.kept_weight > 0.0
        ? reservoir.weight_sum / (float(candidates) * reservoir.kept_weight * probability) : 0.0;
    reservoir.kept.contribution = scale(reservoir.kept.contribution, vec3(ris_weight));
    return reservoir.kept;
}

#endif
