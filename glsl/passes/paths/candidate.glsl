// The candidates of a path for its pixel's reservoir, after its first ray, and the light that reservoirs leave out.
#ifndef PASSES_PATHS_CANDIDATE_GLSL
#define PASSES_PATHS_CANDIDATE_GLSL

#include "passes/paths/path.glsl"
#include "passes/paths/reservoir.glsl"

// From scene/sampling.glsl and its includes: pass-through lights, which are spheres, add to a ray's radiance and don't
// end it. LightHit is what a ray finds of one (intersect_light) or of a light at infinity (evaluate_light); its
// inverse_solid_angle_pdf is 0 without a hit. Portals are openings through which an environment lights a room;
// evaluate_portal_pdf includes the portal's probability where lights are chosen by power, and strategy_weight is the
// MIS weight of a ray for one of the strategies that sample the environment. choose_weighted is a step of weighted
// reservoir sampling.

uvec4 pack_light_point(uint light_index, uint part, vec2 u) { return uvec4(light_index, part, floatBitsToUint(u)); }

// The point of a light that the path's first ray has hit, as PathReservoir.point. A ray may hit several lights; one of
// them becomes the candidate, with the weight of their sum, which keeps the pixel's mean luminance: the first
// pass-through light in the list of lights, else the surface that it hits, else one of the strategies that sample its
// direction to infinity (suns, environments, portals), chosen by its share of the luminance.
uvec4 hit_light_point(inout Path path) {
    bool hits = path.hit.instance != NO_INDEX;
    for (uint i = scene_info.first_pass_through_light; HAS_PASS_THROUGH_LIGHTS
        && i < scene_info.first_light_at_infinity; i++) {
        LightSource light = light_sources.at[i];
        LightHit light_hit = intersect_light(
            light.kind, light.record_index, path.walk.origin, path.walk.direction, path.hit.t
        );
        if (light_hit.inverse_solid_angle_pdf > 0.0) { return pack_light_point(i, 0u, light_hit.u); }
    }
    if (hits) {
        uint light_index = instances.at[path.hit.instance].light_index;
        return pack_light_point(light_index, path.hit.triangle, invert_triangle_sample(path.hit.barycentrics));
    }
    uvec4 point = uvec4(NO_INDEX);
    float sum = 0.0;
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_end; i++) {
        LightSource light = light_sources.at[i];
        LightHit light_hit = evaluate_light(light.kind, light.record_index, path.walk.direction);
        if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { continue; }
        float probability = light_probability_by_power(light), emitted_luminance = luminance(light_hit.radiance);
        float map_pdf = probability / light_hit.inverse_solid_angle_pdf, pdf_sum = map_pdf;
        if (SCENE_PORTAL && light.kind == LIGHT_ENVIRONMENT) {
            pdf_sum += sum_portal_pdfs(path.receiver.position, path.walk.direction, NO_INDEX);
        }
        float weight = emitted_luminance * strategy_weight(map_pdf, 1.0, pdf_sum, path.walk.mis_pdf);
        if (choose_weighted(sum, weight, path.rng)) { point = pack_light_point(i, light_hit.part, light_hit.u); }
        uint end = SCENE_PORTAL && light.kind == LIGHT_ENVIRONMENT ? portal_end() : 0u;
        for (uint j = scene_info.first_portal_record; j < end; j++) {
            float portal_pdf = evaluate_portal_pdf(j, path.receiver.position, path.walk.direction);
            if (!(portal_pdf > 0.0)) { continue; }
            weight = emitted_luminance * strategy_weight(
                portal_pdf, portal_choice_ratio(j, path.receiver), pdf_sum, path.walk.mis_pdf
            );
            if (choose_weighted(sum, weight, path.rng)) {
                vec2 u = invert_portal_sample(j, path.receiver.position, path.walk.direction);
                point = pack_light_point(portal_light(j), 0u, u);
            }
        }
    }
    return point;
}

// Of a path that has traced its first ray: whether that is of a delta lobe, such as a smooth coat over a rough base.
// Other pixels can't take its direction, so that the light goes to the path's own pixel without reservoirs.
bool first_ray_is_delta(Path path) { return path.sum_of_inverse_pdfs == 0.0; }

// Writes the candidates of a path that has traced its first ray, and returns the light that reservoirs leave out. After
// one ray, `path.radiance` is only what is emitted where it ended.
PerLobe write_candidate(inout Path path, uint index, float perceptual_roughness) {
    // Target functions leave out the transmittance of surfaces. Since the ray has passed blended surfaces before its
    // hit by chance, radiance over the probability of that is the estimate without their transmittance.
    RayTransmittance passed = path.first_transmittance;
    PerLobe at_hit = ZERO_LOBES;
    bool delta = first_ray_is_delta(path);
    if (!delta) {
        vec3 arriving = path.radiance * transmittance(path.first_medium, path.hit.t);
        vec3 emitted = path.first_along_ray.radiance_over_probability + arriving / passed.probability;
        at_hit = scale(path.first_weight, emitted);
    }
    float sampled_luminance = luminance(sum(reused_lobes(path.direct, perceptual_roughness)));
    float light_hit_luminance = luminance(sum(reused_lobes(at_hit, perceptual_roughness)));
    float weight_sum = sampled_luminance + light_hit_luminance;
    ReservoirCandidate candidate;
    candidate.light_resampling_weight = weight_sum;
    if (rand_f(path.rng) * weight_sum < light_hit_luminance) {
        candidate.light = hit_light_point(path);
    } else {
        uint rng = path.light_sample.seed;
        candidate.light = pack_light_point(path.light_sample.light_index, path.light_sample.part, rand_vec2f(rng));
    }
    if (candidate.light.x == NO_INDEX) { candidate.light_resampling_weight = 0.0; }
    candidate.instance = path.hit.instance;
    candidate.path_contribution_weight =
        path.hit.instance == NO_INDEX ? 0.0 : path.sum_of_inverse_pdfs / passed.probability;
    candidate.position = vec3(0.0);
    candidate.normal = 0u;
    if (path.hit.instance != NO_INDEX) {
        candidate.position = path.vertex.origin;
        candidate.normal = pack_octahedral_2x16(path.vertex.geometric_normal);
    }
    candidate.radiance = path.reusable_radiance;
    paths_reservoir_candidates.at[index] = candidate;

    bool reuses = reuses_specular(perceptual_roughness);
    vec3 specular = reuses ? vec3(0.0) : direct_light(path).specular;
    if (delta || !reuses) {
        specular += indirect_light(path).specular + apply_first_weight(path, path.reusable_radiance).specular;
    }
    return PerLobe(vec3(0.0), specular);
}

#endif
