// What a path offers to its pixel's reservoir after its first ray, and what it keeps for the pixel alone.
#ifndef PASSES_PATHS_CANDIDATE_GLSL
#define PASSES_PATHS_CANDIDATE_GLSL

#include "passes/paths/path.glsl"
#include "passes/paths/reservoir.glsl"

uvec4 light_point(uint light_index, uint part, vec2 u) { return uvec4(light_index, part, floatBitsToUint(u)); }

// The point of a light that the path's first ray has met. A light that it passes stands for what lies behind it too;
// where lights at infinity overlap, such as a sun and its sky, one of them stands for all, by its radiance.
uvec4 light_sample_of_hit(inout Path path) {
    bool hits = path.hit.instance != NO_INDEX;
    vec3 origin = hits ? path.vertex.position - path.hit.t * path.walk.direction : path.vertex.origin;
    for (uint i = scene_info.first_light_without_surface; SCENE_SPHERE && i < scene_info.first_light_at_infinity; i++) {
        LightSource light = light_sources.at[i];
        MetLight met = cross_light(light.kind, light.index, origin, path.walk.direction, path.hit.t);
        if (met.inverse_pdf > 0.0) { return light_point(i, 0u, met.u); }
    }
    if (hits) {
        uint light_index = instances.at[path.hit.instance].light_index;
        return light_point(light_index, path.hit.triangle, triangle_numbers(path.hit.barycentrics));
    }
    uvec4 point = uvec4(NO_INDEX);
    float sum = 0.0;
    for (uint i = scene_info.first_light_at_infinity; i < scene_info.light_count; i++) {
        LightSource light = light_sources.at[i];
        MetLight met = meet_light(light.kind, light.index, path.walk.direction);
        bool chosen = met.inverse_pdf > 0.0 && choose_weighted(sum, luminance(met.radiance), path.rng);
        if (chosen) { point = light_point(i, met.part, met.u); }
    }
    return point;
}

// Writes the offer of a path that has traced its first ray, and returns the light that is the pixel's alone. Until now
// `path.radiance` is what lights emit where the ray ended.
LobeRadiance write_candidate(inout Path path, uint index, float perceptual_roughness) {
    // Targets leave out what light passes on its way, and rays find what is behind it with a probability.
    RayTransmittance through = path.first_transmittance;
    LobeRadiance met = scale(path.first_weight, path.first_along_ray.for_reservoir
        + path.radiance / through.probability);
    float drawn_luminance = luminance(sum(shared_lobes(path.direct, perceptual_roughness)));
    float met_luminance = luminance(sum(shared_lobes(met, perceptual_roughness)));
    float luminance_sum = drawn_luminance + met_luminance;
    ReservoirCandidate candidate;
    candidate.light_weight = luminance_sum;
    if (rand_f(path.rng) * luminance_sum < met_luminance) {
        candidate.light = light_sample_of_hit(path);
    } else {
        uint rng = path.direct_sample.seed;
        candidate.light = light_point(path.direct_sample.light_index, path.direct_sample.part, rand_vec2f(rng));
    }
    candidate.instance = path.hit.instance;
    // the squared slope is of the first ray alone until now
    candidate.hit_weight = path.hit.instance == NO_INDEX ? 0.0 : path.squared_slope / through.probability;
    candidate.position = path.vertex.origin;
    candidate.normal = pack_octahedral_2x16(path.vertex.geometric_normal);
    candidate.radiance = path.reusable_radiance;
    paths_reservoir_candidates.at[index] = candidate;

    LobeRadiance light = path_light(path);
    LobeRadiance reusable_radiance = indirect_light(path, path.reusable_radiance);
    light.specular += reusable_radiance.specular;
    return LobeRadiance(vec3(0.0), kept_specular(light, perceptual_roughness));
}

#endif
