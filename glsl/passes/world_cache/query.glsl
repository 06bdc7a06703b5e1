// What others ask of the world cache: irradiance anywhere on surfaces, and with it what a path's last hit reflects.
#ifndef PASSES_WORLD_CACHE_QUERY_GLSL
#define PASSES_WORLD_CACHE_QUERY_GLSL

#include "passes/ray_count.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/brdf.glsl"
#include "scene/sampling.glsl"

struct WorldCacheResult {
    bool found;  // false: no value yet, or no place left
    vec3 irradiance;
};

const float JITTER_HEIGHT = 0.05;  // in cells: over what surfaces rise themselves

// Doubles with distance. Rounded up by chance, so that levels fade into each other.
float get_cell_size(vec3 world_position, inout uint rng) {
    float level = log2(1.0 + distance(world_position, uniforms.world_from_view[3]) / uniforms.world_cache_lod_distance);
    float part = fract(level);
    return uniforms.world_cache_cell_size * power_of_two(int(level) + (rand_f(rng) < part * part * part ? 1 : 0));
}

// Of the cell where a point lies that is moved by chance within the tangent plane, which hides the grid. Differs from Solari: not
// into a cell that lies behind a wall, which the short ray on the way there finds.
WorldCacheKey choose_key(vec3 world_position, vec3 normal, float cell_size, inout uint rng) {
    vec2 jitter = uniforms.world_cache_jitter * cell_size * sample_disk(rand_vec2f(rng));
    vec3 way = orthonormalize(normal) * vec3(jitter, 0.0);
    WorldCacheKey key = make_world_cache_key(world_position + way, normal, cell_size);
    if (uniforms.world_cache_leak_prevention == 0u) { return key; }
    WorldCacheKey own_key = make_world_cache_key(world_position, normal, cell_size);
    if (key.checksum == own_key.checksum) { return key; }
    count_ray(RAYS_OF_WORLD_CACHE);
    return trace_visibility(world_position + JITTER_HEIGHT * cell_size * normal, way, 1.0) ? key : own_key;
}

// Keeps the cell alive for `lifetime` more frames. `ray_t`: length of the ray that came here; where it is shorter than a cell, the
// cell might lie on both sides of what the ray met, so that the smallest is taken; INFINITY where this isn't wanted.
WorldCacheResult query_world_cache(
    vec3 world_position, vec3 geometric_world_normal, float ray_t, uint lifetime, inout uint rng
) {
    WorldCacheResult nothing = WorldCacheResult(false, vec3(0.0));
    if (uniforms.world_cache == 0u) { return nothing; }
    float cell_size = get_cell_size(world_position, rng);
    if (uniforms.world_cache_leak_prevention != 0u && ray_t < cell_size) { cell_size = uniforms.world_cache_cell_size; }

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
    if (brdf_lambert) { return material.base_color; }
    vec2 ab = material.roughness <= MIRROR_ROUGHNESS
        ? mirror_albedo(cosine) : lookup_brdf_table(cosine, material.perceptual_roughness);
    vec3 f0 = 0.16 * material.reflectance * material.reflectance;
    vec3 dielectric = specular_albedo(f0, ab);
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_SUM) { through = vec3(1.0); }
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);  // the second factor's mean over the hemisphere
    }
    return mix(dielectric + through * material.base_color, specular_albedo(material.base_color, ab), material.metallic);
}

// From one light sample, seen or not: for where the cache knows nothing. Differs from Solari, which takes 0 there: so no light is
// lost while cells come and go.
vec3 sample_irradiance(vec3 world_position, vec3 geometric_world_normal, float ray_offset, inout uint rng) {
    if (scene_info.light_count == 0u) { return vec3(0.0); }
    ResolvedLightSample light_sample = resolve_light_sample(generate_random_light_sample(rng));
    LightContribution light = calculate_resolved_light_contribution(light_sample, world_position);
    float cosine = dot(light.wi, geometric_world_normal);
    vec3 irradiance = light.received_radiance * (light.inverse_pdf * cosine);
    if (!(cosine > 0.0 && max_component(irradiance) > 0.0)) { return vec3(0.0); }
    vec3 origin = world_position + ray_offset * geometric_world_normal;
    count_ray(RAYS_OF_WORLD_CACHE);
    return trace_light_visibility(origin, light_sample) ? irradiance : vec3(0.0);
}

// What arrives at a hit. ray_t and lifetime as in query_world_cache.
vec3 find_irradiance(ResolvedRayHitFull hit, float ray_t, uint lifetime, inout uint rng) {
    WorldCacheResult cached = query_world_cache(hit.world_position, hit.geometric_world_normal, ray_t, lifetime, rng);
    if (cached.found) { return cached.irradiance; }
    return sample_irradiance(hit.world_position, hit.geometric_world_normal, hit.ray_offset, rng);
}

// What a hit reflects towards `wo`, without what it emits: a path's end.
vec3 reflected_radiance(ResolvedRayHitFull hit, vec3 wo, float ray_t, uint lifetime, inout uint rng) {
    vec3 irradiance = find_irradiance(hit, ray_t, lifetime, rng);
    return surface_albedo(hit.material, dot(hit.world_normal, wo)) * (INVERSE_PI * irradiance);
}

#endif
