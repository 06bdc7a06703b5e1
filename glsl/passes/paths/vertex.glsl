// A vertex of a path, a surface point seen from a direction; and next event estimation there.
#ifndef PASSES_PATHS_VERTEX_GLSL
#define PASSES_PATHS_VERTEX_GLSL

#include "passes/bindings.glsl"  // paths_settings
#include "passes/paths/per_lobe.glsl"
#include "passes/ray_count.glsl"
#include "scene/walk.glsl"  // and scene/brdf.glsl: BRDFs; scene/sampling.glsl: lights

struct Vertex {
    vec3 position;
    vec3 geometric_normal;  // faces the direction from which the vertex is seen
    vec3 origin;            // of rays that leave the vertex on the side of geometric_normal, without the lift
    float lift;             // SurfaceInteraction.lift
    mat3 frame;             // its z axis is the shading normal; v * frame is v in the frame
    vec3 wo;                // in that frame
    Brdf brdf;
    Medium above, below;    // on the side from which the vertex is seen, and on the other one
};

// A vertex without its BRDF and media. `wo` is in world space.
Vertex make_vertex(
    vec3 position, vec3 geometric_normal, float ray_offset, float lift, vec3 shading_normal, vec3 wo
) {
    Vertex vertex;
    vertex.position = position;
    vertex.geometric_normal = geometric_normal;
    vertex.origin = position + ray_offset * geometric_normal;
    vertex.lift = lift;
    vertex.frame = orthonormalize(shading_normal);
    vertex.wo = wo * vertex.frame;
    vertex.above = vertex.below = NO_MEDIUM;
    return vertex;
}

// The medium in which a ray leaves the vertex.
Medium medium_towards(Vertex vertex, vec3 direction) {
    bool transmits = SCENE_TRANSMISSION && vertex.lift == 0.0 && dot(direction, vertex.geometric_normal) < 0.0;
    return transmits ? vertex.below : vertex.above;
}

// The origin of rays in a direction, offset to that side of the surface.
vec3 ray_origin(Vertex vertex, vec3 direction) {
    float cosine = dot(direction, vertex.geometric_normal);
    bool transmits = SCENE_TRANSMISSION && cosine < 0.0 && vertex.lift == 0.0;
    if (transmits) { return 2.0 * vertex.position - vertex.origin; }
    return vertex.origin + lift_along(vertex.lift, cosine) * vertex.geometric_normal;
}

// BRDF times cosine, by lobe.
PerLobe lobes_times_cosine(Vertex vertex, vec3 wi) {
    return PerLobe(
        evaluate_diffuse_brdf(vertex.brdf, vertex.wo, wi), evaluate_specular_brdf(vertex.brdf, vertex.wo, wi)
    );
}

// Makes surfaces rougher that a path reaches after a non-delta bounce, against fireflies of caustics. Kaplanyan and
// Dachsbacher, "Path Space Regularization for Holistic and Robust Light Transport" (2013).
#define LIMIT_ROUGHNESS(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { limit_roughness(material.name, sqrt(min_roughness)); }
void regularize(inout ResolvedMaterial material, float sum_of_inverse_pdfs) {
    float min_roughness = min(1.0, 0.5 * sqrt(sum_of_inverse_pdfs)) * paths_settings.regularization;
    LAYERS(LIMIT_ROUGHNESS)
    if (material.base.roughness >= min_roughness) { return; }
    material.base.roughness = min_roughness;
    material.base.perceptual_roughness = sqrt(min_roughness);
}

// ---- light samples -----------------------------------------------------------------------------------
//
// By scene/sampling.glsl: choose_leaf chooses a leaf of the tree of lights, which is a light or some neighboring
// triangles of an emissive mesh, and sample_leaf a point of it (LightSample). resolve_light_sample makes that a point
// in world space with its radiance and pdf (ResolvedLightSample), and calculate_resolved_light_contribution what
// reaches the vertex from there without occlusion (LightContribution).

// What a vertex reflects of a light sample through the medium without occlusion, over the sample's pdf, with its MIS
// weight against BRDF samples. `expected_candidates`, the expected number of RIS candidates, is n_l in Veach's
// multi-sample model, for one BRDF sample.
PerLobe evaluate_next_event(Vertex vertex, LightContribution light, float expected_candidates) {
    vec3 wi = light.wi * vertex.frame;
    if (!is_on_valid_side(wi.z, light.wi, vertex.geometric_normal, vertex.lift)) { return ZERO_LOBES; }
    float light_pdf = expected_candidates * light.solid_angle_pdf;
    float mis_weight = power_heuristic(light_pdf, brdf_pdf(vertex.brdf, vertex.wo, wi));
    vec3 received = light.radiance_in_area_measure * mis_weight * light.inverse_area_pdf;
    if (SCENE_ABSORPTION) { received *= transmittance(medium_towards(vertex, light.wi), light.distance); }
    return scale(lobes_times_cosine(vertex, wi), received);
}

// Next event estimation before the shadow ray.
struct RisLightSample {
    LightSample light_sample;
    ResolvedLightSample resolved;  // for its shadow ray
    vec3 wi;               // in world space, towards the light
    PerLobe contribution;  // what the vertex reflects if nothing is in between; 0: no shadow ray is needed
};

Receiver receiver(Vertex vertex) { return Receiver(vertex.position, vertex.frame[2]); }

// Weighted reservoir sampling of light samples. The weight is the luminance of the contribution.
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

// Whether a light sample is at infinity in a direction that goes through no portal. If the vertex is in a room whose
// openings are portals, such a sample is occluded.
bool misses_all_portals(ResolvedLightSample light_sample, vec3 receiver, vec3 direction) {
    if (!has_portals() || light_sample.kind == LIGHT_PORTAL || !is_at_infinity(light_sample.kind)) { return false; }
    return !passes_a_portal(receiver, direction);
}

// Resampled importance sampling (Talbot et al., "Importance Resampling for Global Illumination", 2005) of lights. The
// target function is the unoccluded luminance that the vertex reflects. In a room, samples that miss all portals are
// occluded, but whether the vertex is in a room isn't known. So these samples have a reservoir of their own, which is
// chosen with a probability of at most 1/2 if the other has a sample: the loss is at most half of the samples.
RisLightSample sample_light_by_ris(Vertex vertex, uint candidates, float expected_candidates, inout uint rng) {
    RisReservoir reservoir, portal_misses;
    reservoir.kept.contribution = ZERO_LOBES;
    reservoir.kept_weight = reservoir.weight_sum = 0.0;
    portal_misses = reservoir;
    for (uint i = 0u; i < candidates; i++) {
        ChosenLeaf chosen = choose_leaf(receiver(vertex), rng);
        LightSample light_sample = sample_leaf(chosen.leaf, rng);
        ResolvedLightSample resolved = resolve_light_sample(light_sample, chosen.probability);
        LightContribution light = calculate_resolved_light_contribution(resolved, vertex.position);
        RisLightSample ris_sample = RisLightSample(
            light_sample, for_shadow_ray(resolved, light.wi), light.wi,
            evaluate_next_event(vertex, light, expected_candidates)
        );
        if (misses_all_portals(resolved, vertex.position, light.wi)) {
            add_to_reservoir(portal_misses, ris_sample, rng);
        } else {
            add_to_reservoir(reservoir, ris_sample, rng);
        }
    }
    float probability = 1.0;
    if (SCENE_PORTAL && portal_misses.weight_sum > 0.0) {
        float miss_probability = portal_misses.weight_sum / (portal_misses.weight_sum + reservoir.weight_sum);
        miss_probability = reservoir.weight_sum > 0.0 ? min(miss_probability, 0.5) : 1.0;
        bool takes_miss = rand_f(rng) < miss_probability;
        probability = takes_miss ? miss_probability : 1.0 - miss_probability;
        if (takes_miss) { reservoir = portal_misses; }
    }
    float ris_weight = reservoir.kept_weight > 0.0
        ? reservoir.weight_sum / (float(candidates) * reservoir.kept_weight * probability) : 0.0;
    reservoir.kept.contribution = scale(reservoir.kept.contribution, vec3(ris_weight));
    return reservoir.kept;
}

#endif
