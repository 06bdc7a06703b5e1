// A path through the scene. Its first vertex (x1 in papers) is the surface that the pixel shows, from the G-buffer; the
// first ray leads from there to the second vertex (x2). At each vertex `choose_rays` chooses two rays, one to a light
// and one that leads on, `trace_rays` traces both, and `arrive` makes the next vertex. A path ends in the world cache,
// where a ray hits nothing, by Russian roulette, or at the bounce limit. MIS by the power heuristic (Veach 1997).
// Without world cache and regularization, the mean is that of the reference path tracer. Solari in Bevy 0.20 traces
// such paths.
#ifndef PASSES_PATHS_PATH_GLSL
#define PASSES_PATHS_PATH_GLSL

#include "common/random.glsl"
#include "passes/paths/stored_path.glsl"
#include "passes/paths/vertex.glsl"  // and scene/walk.glsl: the walk along rays, and media
#include "passes/ray_count.glsl"
#include "passes/world_cache/query.glsl"  // and map.glsl: get_cell_size

// Paths end in the world cache before the bounce limit if their last ray is longer than a cell's diagonal, and their
// footprint larger than that of one such ray, sampled along the normal of a Lambert surface (1 / pdf = pi).
const float MIN_RAY_IN_CELLS = 1.7320508;        // sqrt(3)
const float MIN_FOOTPRINT_IN_CELLS = 3.0699801;  // sqrt(3) * sqrt(pi)

// Whether pixels share light through reservoirs, passes/paths/reservoir.glsl: the setting restir. The ids of
// specialization constants, NAME_id, are numbered by solari_vk/gpu/shaders/compiler.py.
layout(constant_id = paths_reuse_id) const bool paths_reuse = false;

struct Path {
    Vertex vertex;                // the current one, from which the next ray leaves
    Receiver receiver;            // the vertex for which choose_rays has chosen rays
    ShadowRay shadow_ray;         // from that vertex to a light
    bool has_ray;                 // whether a ray leads on from that vertex, along `walk`; without one the path ends
    Walk walk;                    // along the last ray; its throughput is without `first_weight`
    Hit hit;                      // of the last ray
    bool specular_only;           // the next direction is of the specular lobe: the world cache gave the diffuse light
    uint bounce;                  // rays chosen so far, without shadow rays
    uint delta_bounces;           // of them, those in directions of delta lobes
    PerLobe first_weight;         // BRDF times cosine over pdf of the first ray, by lobe of the first vertex
    // Of the blended surfaces and thin-walled glass that the first ray has passed, with a `probability`; `weight` is
    // their transmittance over that, with reuse times that of `first_medium`. `radiance` and `reusable_radiance` are
    // without it.
    RayTransmittance first_transmittance;
    Medium first_medium;          // with reuse, the medium of the first ray
    LightAlongRay first_along_ray;  // of pass-through lights on the first ray: sphere lights, which don't end it
    vec3 radiance;                // that the first ray carries from x2 or infinity, without `reusable_radiance`
    // With reuse, apart from `radiance`: what x2 reflects by its diffuse lobe; and whether light that is found after x2
    // is added to this, or to `radiance`.
    vec3 reusable_radiance;
    bool diffuse_at_x2;
    LightSample light_sample;     // of the shadow ray
    PerLobe direct;               // what the first vertex reflects of it, without `direct_transmittance`
    vec3 direct_transmittance;    // of surfaces
    bool first_ray_is_diffuse;    // whether the first ray was sampled from the diffuse lobe
    // Over the path's directions so far, in steradians; 0 while all were of delta lobes. A measure of how far paths
    // have spread.
    float sum_of_inverse_pdfs;
    // In meters: the sum over rays of length * sqrt(sum_of_inverse_pdfs). Müller et al., "Real-time Neural Radiance
    // Caching for Path Tracing" (2021), whose area spread is the square of such a sum, take instead of
    // sum_of_inverse_pdfs the ray's own 1 / pdf, over the cosine at its hit.
    float footprint;
    uint cache_lifetime;                // of the world cache's cells that the path looks up, in frames
    // For the first vertex: the number of RIS candidates of its light sample, at most that of the parts of all lights
    // (triangles, texels, or whole lights), and the random numbers of its lobe and direction.
    uint candidates;
    float lobe_u;
    vec2 u;
    uint rng;
};

// A path without its first vertex.
Path start_path(uint rng) {
    Path path;
    path.walk = start_walk(vec3(0.0), vec3(0.0));
    path.walk.delta_path_from_camera = true;
    path.hit = NO_HIT;
    path.hit.t = 0.0;  // unknown: no ray is traced yet
    path.has_ray = false;
    path.shadow_ray = ShadowRay(vec3(0.0), vec3(0.0), 0.0, ZERO_LOBES);
    path.first_medium = NO_MEDIUM;
    path.specular_only = false;
    path.bounce = path.delta_bounces = 0u;
    path.first_weight = path.direct = ZERO_LOBES;
    path.radiance = path.reusable_radiance = vec3(0.0);
    path.first_transmittance = FULL_TRANSMITTANCE;
    path.first_along_ray = NO_LIGHT_ALONG_RAY;
    path.direct_transmittance = vec3(1.0);
    path.diffuse_at_x2 = false;
    path.light_sample = LightSample(NO_INDEX, 0u, 0u);
    path.first_ray_is_diffuse = true;
    path.sum_of_inverse_pdfs = path.footprint = 0.0;
    path.cache_lifetime = world_cache_settings.lifetime;
    path.candidates = min(paths_settings.candidates, scene_info.part_count);
    path.rng = rng;
    return path;
}

// What the first vertex reflects of radiance that leaves x2.
PerLobe apply_first_weight(Path path, vec3 radiance) {
    return scale(path.first_weight, path.first_transmittance.weight * radiance);
}

// What the first vertex reflects of its light sample, and of what the first ray carries.
PerLobe direct_light(Path path) { return scale(path.direct, path.direct_transmittance); }
PerLobe indirect_light(Path path) {
    vec3 found = path.first_along_ray.radiance + path.first_transmittance.weight * path.radiance;
    return scale(path.first_weight, found);
}

PerLobe path_light(Path path) {
    PerLobe direct = direct_light(path), indirect = indirect_light(path);
    return PerLobe(direct.diffuse + indirect.diffuse, direct.specular + indirect.specular);
}

// diffuse_at_x2: whether x2 reflects the light by its diffuse lobe.
void add_light(inout Path path, vec3 light, bool diffuse_at_x2) {
    if (paths_reuse && diffuse_at_x2) { path.reusable_radiance += light; } else { path.radiance += light; }
}

// The probability of next event estimation, which is lower the smoother a metal is, since BRDF samples find more of the
// light then. A layer over the metal that isn't a delta lobe raises it: no BRDF sample can hit the point
// lights that it reflects.
float nee_probability(Brdf brdf) {
    if (scene_info.light_count == 0u) { return 0.0; }
    Specular specular = brdf.specular;
    float probability = has_delta_base(brdf) ? 0.0 : mix(1.0, specular.perceptual_roughness, specular.metallic);
    return max(probability, layers_spread(brdf));
}

// The weight of a BRDF sample, BRDF times cosine over pdf, by lobe. Samples of delta lobes have an infinite pdf.
PerLobe lobe_weights(BrdfSample next) {
    if (next.pdf == INFINITY) { return PerLobe(vec3(0.0), next.weight); }
    PerLobe values = PerLobe(next.diffuse_value, next.specular_value);
    return next.pdf > 0.0 ? scale(values, vec3(1.0 / next.pdf)) : ZERO_LOBES;
}

// Whether the specular lobe is so broad that its light is computed from the cache's irradiance too, or missing
// (lambertian_surfaces).
bool is_rough(ResolvedMaterial material) {
    return lambertian_surfaces || material.base.roughness >= paths_settings.cache_roughness;
}

// Makes the vertex of the surface that the path's last ray hit.
void make_path_vertex(inout Path path, inout SurfaceInteraction surface) {
    Medium below = medium_below(path.hit.instance, surface.material, path.walk.medium);
    regularize(surface.material, path.sum_of_inverse_pdfs);
    disperse(path.walk, path.hit.instance, surface.material, path.rng);
    path.vertex = make_vertex(
        surface.world_position, surface.geometric_world_normal, surface.ray_offset, surface.lift,
        surface.world_normal, -path.walk.direction
    );
    path.vertex.brdf = prepare_brdf(surface.material, path.vertex.wo);
    path.vertex.above = path.walk.medium;
    path.vertex.below = below;
}

// Adds what the hit reflects of the world cache's irradiance: by both lobes if is_rough, and then the path ends; else
// by the diffuse lobe, and the path goes on by the specular one, with its share of the albedo as probability. Returns
// whether the path goes on, which it always does where the cache isn't used or has no value. It isn't used at metal
// mirrors and surfaces that transmit light (has_no_cell). Differs from Solari, where the cache is used for the whole
// surface, and paths end there.
bool look_up_world_cache(inout Path path, SurfaceInteraction surface) {
    if (frame_settings.world_cache == 0u || has_no_cell(surface.material)) { return true; }
    float cell_size = get_cell_size(surface.world_position, path.rng);
    bool far = path.hit.t > MIN_RAY_IN_CELLS * cell_size && path.footprint > MIN_FOOTPRINT_IN_CELLS * cell_size;
    if (!far && path.bounce < paths_settings.bounces + path.delta_bounces) { return true; }
    WorldCacheResult cached = query_cell_of_size(
        surface.world_position, surface.geometric_world_normal, cell_size, path.cache_lifetime, path.rng
    );
    if (!cached.found) { return true; }
    LobeAlbedos albedos = lobe_albedos(surface.material, path.vertex.wo);
    bool rough = is_rough(surface.material);
    vec3 albedo = albedos.diffuse + (rough ? albedos.specular : vec3(0.0));
    add_light(
        path, path.walk.throughput * albedo * (INVERSE_PI * cached.irradiance),
        path.diffuse_at_x2 || path.bounce == 1u  // at x2 the light of a rough specular lobe counts as diffuse
    );
    float specular_probability = luminance(albedos.specular) / luminance(albedos.specular + albedos.diffuse);
    if (rough || !(rand_f(path.rng) < specular_probability)) { return false; }
    path.walk.throughput /= specular_probability;
    path.specular_only = true;
    return true;
}

ShadowRay make_shadow_ray(Vertex vertex, RisLightSample chosen) {
    vec3 origin = ray_origin(vertex, chosen.wi);
    ResolvedLightSample seen = shadow_sample_for_receiver(chosen.resolved, origin);
    float t_max = is_at_infinity(seen.kind) ? INFINITY : 1.0;
    return ShadowRay(origin, segment_to_light(origin, seen), t_max, chosen.contribution);
}

// Chooses a light sample and the next direction at the path's vertex.
void choose_rays(inout Path path) {
    if (path.specular_only) { path.vertex.brdf = without_diffuse_lobe(path.vertex.brdf); }
    path.specular_only = false;
    Brdf brdf = path.vertex.brdf;
    bool first = path.bounce == 0u;
    uint candidates = path.candidates;
    if (!first) {
        candidates = min(paths_settings.later_candidates, scene_info.part_count);
        path.lobe_u = rand_f(path.rng);
        path.u = rand_vec2f(path.rng);
    }
    path.receiver = receiver(path.vertex);
    path.shadow_ray.contribution = ZERO_LOBES;
    float probability = nee_probability(brdf);
    float expected_candidates = probability * float(candidates);  // for each BRDF sample, as MIS counts them
    if (rand_f(path.rng) < probability) {
        RisLightSample chosen = sample_light_by_ris(path.vertex, candidates, expected_candidates, path.rng);
        chosen.contribution = scale(chosen.contribution, path.walk.throughput / probability);
        if (max_component(sum(chosen.contribution)) > 0.0) {
            path.shadow_ray = make_shadow_ray(path.vertex, chosen);
            path.light_sample = chosen.light_sample;
        }
    }

    BrdfSample next = sample_brdf(brdf, path.vertex.wo, path.lobe_u, path.u);
    if (first) {
        path.first_weight = lobe_weights(next);
        path.first_ray_is_diffuse = next.diffuse;
        next.weight = vec3(1.0);
    } else if (paths_reuse && path.bounce == 1u) {
        // Reservoirs keep what x2 reflects by its diffuse lobe. So later light is counted for one lobe of x2, which is
        // chosen by the luminance of its weight.
        PerLobe weights = lobe_weights(next);
        float diffuse_probability = luminance(weights.diffuse) / max(luminance(sum(weights)), 1e-30);
        path.diffuse_at_x2 = rand_f(path.rng) < diffuse_probability;
        next.weight = path.diffuse_at_x2 ? weights.diffuse / diffuse_probability
            : weights.specular / (1.0 - diffuse_probability);
    }
    bool valid = scatter(path.walk, next, path.vertex.frame, path.vertex.geometric_normal, path.vertex.lift,
        path.vertex.below);
    path.walk.origin = ray_origin(path.vertex, path.walk.direction);
    path.walk.mis_pdf = expected_candidates > 0.0 ? next.pdf / expected_candidates : INFINITY;
    path.sum_of_inverse_pdfs += 1.0 / next.pdf;
    path.bounce += 1u;
    path.delta_bounces += next.pdf == INFINITY && path.delta_bounces < MAX_DELTA_BOUNCES ? 1u : 0u;
    float survival_probability = max_component(sum(apply_first_weight(path, path.walk.throughput)));
    path.has_ray = valid && survives(path.walk, survival_probability, path.bounce, path.rng);
}

// What the rays of a vertex have met.
struct TracedRays {
    vec3 visibility;  // of the light sample: the transmittance of surfaces
    Segment segment;
};

bool has_shadow_ray(Path path) { return max_component(sum(path.shadow_ray.contribution)) > 0.0; }

TracedRays trace_rays(inout Path path) {
    TracedRays traced = TracedRays(vec3(0.0), Segment(NO_HIT, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u));
    if (has_shadow_ray(path)) {
        count_ray();
        ShadowRay ray = path.shadow_ray;
        traced.visibility = trace_transmittance(ray.origin, ray.direction, ray.t_max);
    }
    if (path.has_ray) {
        traced.segment = trace_segment(path.walk, path.receiver, path.rng);
        count_rays(traced.segment.rays);
    }
    return traced;
}

// Adds what the light sample sends.
void add_light_sample(inout Path path, vec3 visibility) {
    if (visibility == vec3(0.0)) { return; }
    PerLobe contribution = path.shadow_ray.contribution;
    if (path.bounce == 1u) {
        path.direct = contribution;
        path.direct_transmittance = visibility;
    } else if (path.bounce == 2u) {  // the light sample is of x2
        add_light(path, contribution.diffuse * visibility, true);
        add_light(path, contribution.specular * visibility, false);
    } else {
        add_light(path, sum(contribution) * visibility, path.diffuse_at_x2);
    }
}

// Adds the light that rays have found. Returns whether the path has hit a surface; else it has ended.
bool add_rays(inout Path path, TracedRays traced) {
    add_light_sample(path, traced.visibility);
    if (!path.has_ray) { return false; }
    Segment segment = traced.segment;
    path.hit = segment.hit;
    if (path.bounce == 1u) {
        path.first_along_ray = segment.along_ray;
        path.first_transmittance = segment.transmittance;
        segment.along_ray = NO_LIGHT_ALONG_RAY;
        segment.transmittance = FULL_TRANSMITTANCE;
        if (paths_reuse && SCENE_ABSORPTION) {
            path.first_medium = path.walk.medium;
            path.first_transmittance.weight *= transmittance(path.first_medium, path.hit.t);
            path.walk.medium = NO_MEDIUM;  // until the ray has arrived
        }
    }
    vec3 emitted = vec3(0.0);
    bool hits = accumulate_segment(path.walk, segment, path.receiver, emitted);
    add_light(path, emitted, path.diffuse_at_x2);
    path.footprint += hits ? sqrt(path.sum_of_inverse_pdfs) * path.hit.t : 0.0;
    return hits;
}

// Moves the path to the surface that its last ray has hit. Returns whether it goes on. `resumed`: the path was here
// when it was stored, and only its vertex is made again, without adding light or throughput a second time.
bool arrive(inout Path path, bool resumed) {
    vec3 throughput = path.walk.throughput;
    SurfaceInteraction surface = arrive_at_surface(path.walk, path.hit);
    if (paths_reuse && SCENE_ABSORPTION && !resumed && path.bounce == 1u) { path.walk.medium = path.first_medium; }
    remove_straight_transmission(path.hit, path.walk.direction, surface.material, path.walk.throughput);
    if (resumed) {
        path.walk.throughput = throughput;  // which has these factors already
    } else {
        float light_pdf = hit_light_pdf(path.receiver, path.hit, surface, path.walk.direction);
        add_light(path, emitted_light(path.walk, surface, light_pdf), path.diffuse_at_x2);
    }
    make_path_vertex(path, surface);
    return resumed || look_up_world_cache(path, surface) && path.bounce < paths_settings.bounces + path.delta_bounces;
}

#endif
