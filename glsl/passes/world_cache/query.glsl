// What others ask of the world cache: irradiance anywhere on surfaces, and with it what a ray finds.
#ifndef PASSES_WORLD_CACHE_QUERY_GLSL
#define PASSES_WORLD_CACHE_QUERY_GLSL

#include "passes/past_mirrors.glsl"
#include "passes/ray_count.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/brdf.glsl"
#include "scene/light_visibility.glsl"
#include "scene/sampling.glsl"

struct WorldCacheResult {
    bool found;  // false: no value yet, or no place left
    vec3 irradiance;
};

const float EYE_HEIGHT = 0.05;  // in cells: over what surfaces rise themselves

// Of the cell where a point lies that is moved by chance within the tangent plane, which hides the grid. Differs from Solari: what
// can't see a cell's middle has no share in it, nor in what lies behind a wall; where a wall goes through a point's own cell,
// that has parts, one for each landmark that is the first to be seen.
WorldCacheKey choose_key(vec3 world_position, vec3 normal, float cell_size, inout uint rng) {
    vec2 jitter = world_cache_settings.jitter * cell_size * sample_disk(rand_vec2f(rng));
    vec3 place = world_position + orthonormalize(normal) * vec3(jitter, 0.0);
    WorldCacheKey key = make_world_cache_key(place, normal, cell_size);
    if (world_cache_settings.leak_prevention != WORLD_CACHE_LEAK_PREVENTION_LANDMARKS) { return key; }
    vec3 eye = world_position + EYE_HEIGHT * cell_size * normal;
    uint landmark = 0u;
    for (; landmark < LANDMARKS; landmark++) {
        if (landmark == 1u) {
            vec4 tried = key.bounds;
            key = make_world_cache_key(world_position, normal, cell_size);
            if (key.bounds == tried) { continue; }
        }
        vec2 side = vec2((landmark & 1u) == 0u ? 0.25 : -0.25, (landmark & 2u) == 0u ? 0.25 : -0.25);
        // a tetrahedron, which is a square along any axis
        vec3 from_middle = landmark < 2u ? vec3(0.0) : vec3(side, 4.0 * side.x * side.y);
        vec3 way = key.bounds.xyz + cell_size * (0.5 + from_middle) - world_position;
        count_ray();
        if (trace_visibility(eye, way - dot(way, normal) * normal, 1.0)) { break; }
    }
    return landmark < 2u ? key : part_of_cell(key, landmark);
}

// Keeps the cell alive for `lifetime` more frames. `ray_t`: length of the ray that came here; where it is shorter than a cell, the
// cell might lie on both sides of what the ray met, so that the smallest is taken; INFINITY where this isn't wanted.
WorldCacheResult query_world_cache(
    vec3 world_position, vec3 geometric_world_normal, float ray_t, uint lifetime, inout uint rng
) {
    WorldCacheResult nothing = WorldCacheResult(false, vec3(0.0));
    if (frame_settings.world_cache == 0u) { return nothing; }
    float cell_size = get_cell_size(world_position, rng);
    if (ray_t < cell_size) { cell_size = world_cache_settings.cell_size; }

    WorldCacheKey key = choose_key(world_position, geometric_world_normal, cell_size, rng);
    uint cell = insert_world_cache_cell(key);
    if (cell == NO_INDEX) {
        atomicAdd(world_cache_counters.insert_failures, 1u);
        return nothing;
    }
    atomicMax(world_cache_life.at[cell], lifetime);
    vote_for_point(cell, key.bounds, world_position, geometric_world_normal, rng);
    vec4 irradiance = world_cache_irradiance.at[cell];
    return WorldCacheResult(irradiance.w > 0.0, irradiance.rgb);
}

// ---- what a surface makes of it ---------------------------------------------------------------------

// What the whole surface reflects towards a direction under uniform light. Differs from Solari, which takes the base colour and
// so loses what is specular, or counts it as if metals were white beneath.
vec3 surface_albedo(ResolvedMaterial material, float cosine) {
    if (brdf_lambert || world_cache_settings.surfaces == WORLD_CACHE_SURFACES_DIFFUSE) { return material.base_color; }
    vec2 ab = material.roughness <= MIRROR_ROUGHNESS
        ? mirror_albedo(cosine) : lookup_brdf_table(cosine, material.perceptual_roughness);
    vec3 f0 = 0.16 * material.reflectance * material.reflectance;
    vec3 dielectric = specular_albedo(f0, ab);
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);  // the second factor's mean over the hemisphere
    }
    return mix(dielectric + through * material.base_color, specular_albedo(material.base_color, ab), material.metallic);
}

// From one light sample, seen or not.
vec3 sample_irradiance(ResolvedRayHitFull hit, inout uint rng) {
    if (scene_info.light_count == 0u) { return vec3(0.0); }
    ResolvedLightSample light_sample = resolve_light_sample(generate_random_light_sample(rng));
    LightContribution light = calculate_resolved_light_contribution(light_sample, hit.world_position);
    float cosine = dot(light.wi, hit.geometric_world_normal);
    vec3 irradiance = light.received_radiance * (light.inverse_pdf * cosine);
    if (!(cosine > 0.0 && max_component(irradiance) > 0.0)) { return vec3(0.0); }
    vec3 origin = hit.world_position + hit.ray_offset * hit.geometric_world_normal;
    count_ray();
    return trace_light_visibility(origin, light_sample) ? irradiance : vec3(0.0);
}

const uint MOST_UNKNOWN_HITS = 4u;  // on a path, one after the other

struct Gathered {
    SightPastMirrors sight;
    vec3 reflectance;  // of the surface there, towards the ray: radiance over irradiance
    vec3 irradiance;   // what arrives there
};

vec3 gathered_radiance(Gathered light) {
    return light.sight.emitted + light.sight.throughput * light.reflectance * light.irradiance;
}

// What a ray finds; what emitters give that are met directly is left to others. `short_rays`: whether one shorter than a cell takes
// the finest. Differs from Solari, which takes 0 where the cache knows nothing: there a path goes on until it comes to where
// it does, so that no light is lost while cells come and go.
Gathered gather_light(
    vec3 origin, vec3 direction, float t_max, float cone_width, bool short_rays, uint lifetime, inout uint rng
) {
    Gathered light;
    light.reflectance = vec3(0.0);
    light.irradiance = vec3(0.0);
    vec3 throughput = vec3(1.0);
    for (uint i = 0u; i <= MOST_UNKNOWN_HITS; i++) {
        SightPastMirrors sight = trace_past_mirrors(origin, direction, t_max, cone_width);
        if (i == 0u) {
            light.sight = sight;
        } else {
            throughput *= PI;  // cosine and pdf of the ray leave pi
            light.irradiance += throughput * sight.emitted;
        }
        if (!sight.found) { break; }
        ResolvedRayHitFull hit = sight.surface;
        vec3 reflectance = INVERSE_PI * surface_albedo(hit.material, dot(hit.world_normal, -sight.direction));
        if (i == 0u) {
            light.reflectance = reflectance;
        } else {
            throughput *= sight.throughput * reflectance;
        }
        float ray_t = short_rays ? sight.ray_t : INFINITY;
        WorldCacheResult cached = query_world_cache(hit.world_position, hit.geometric_world_normal, ray_t, lifetime, rng);
        light.irradiance += throughput * (cached.found ? cached.irradiance : sample_irradiance(hit, rng));
        if (cached.found || frame_settings.world_cache == 0u) { break; }
        origin = hit.world_position + hit.ray_offset * hit.geometric_world_normal;
        direction = orthonormalize(hit.geometric_world_normal) * sample_cosine_hemisphere(rand_vec2f(rng));
    }
    return light;
}

#endif
