// Queries of the world cache, Solari's radiance cache in a spatial hash map: the irradiance of any surface point, and
// the light that a ray finds with its help.
#ifndef PASSES_WORLD_CACHE_QUERY_GLSL
#define PASSES_WORLD_CACHE_QUERY_GLSL

#include "passes/specular_chain.glsl"
#include "passes/ray_count.glsl"
#include "passes/world_cache/division.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/walk.glsl"

// The key of the cell in which a point is looked up. The point is jittered in the tangent plane, which hides the grid
// of cells.
WorldCacheKey choose_key(vec3 world_position, vec3 normal, float cell_size, inout uint rng) {
    vec2 jitter = world_cache_settings.jitter * cell_size * sample_disk(rand_vec2f(rng));
    return make_world_cache_key(world_position + orthonormalize(normal) * vec3(jitter, 0.0), normal, cell_size);
}

// The cell of a given size at a surface point, which has a vote for it then; NO_INDEX when the map is full there.
uint find_or_insert_cell(
    vec3 world_position, vec3 geometric_world_normal, float cell_size, out bool is_new, inout uint rng
) {
    WorldCacheKey key = choose_key(world_position, geometric_world_normal, cell_size, rng);
    uint cell = insert_world_cache_cell(key, is_new);
    if (cell == NO_INDEX) {
        atomicAdd(world_cache_counters.insert_failures, 1u);
    } else {
        vote_for_point(cell, key.bounds, world_position, geometric_world_normal, rng);
    }
    return cell;
}

// The irradiance of the cell of a given size at a surface point; the cell is inserted if it is new, and kept alive for
// `lifetime` frames.
WorldCacheResult query_cell_of_size(
    vec3 world_position, vec3 geometric_world_normal, float cell_size, uint lifetime, inout uint rng
) {
    bool is_new;
    uint cell = find_or_insert_cell(world_position, geometric_world_normal, cell_size, is_new, rng);
    if (cell == NO_INDEX) { return NO_CELL; }
    WorldCacheResult cached = read_world_cache_cell(cell, lifetime);
    cached.found = cached.found && is_cell_open(cell, world_position, geometric_world_normal);
    return cached;
}

// The same for a point that a ray of length `ray_t` found: a cell that is longer than the ray may reach around the
// surface that the ray left, so that the finest cell size is used instead. INFINITY turns this rule off, as does the
// setting world_cache_leak_prevention=none.
WorldCacheResult query_world_cache(
    vec3 world_position, vec3 geometric_world_normal, float ray_t, uint lifetime, inout uint rng
) {
    if (frame_settings.world_cache == 0u) { return NO_CELL; }
    float cell_size = get_cell_size(world_position, rng);
    bool has_rule = world_cache_settings.leak_prevention != WORLD_CACHE_LEAK_PREVENTION_NONE;
    if (has_rule && ray_t < cell_size) { cell_size = world_cache_settings.cell_size; }
    return query_cell_of_size(world_position, geometric_world_normal, cell_size, lifetime, rng);
}

// ---- reflection -------------------------------------------------------------------------------------

// The share of uniform incoming light that a surface reflects towards a direction. Differs from Solari, which takes
// the base color (world_cache_surfaces=diffuse) and so ignores the specular lobe of dielectrics and makes metals
// diffuse.
vec3 surface_albedo(ResolvedMaterial material, vec3 wo) {
    if (world_cache_settings.surfaces == WORLD_CACHE_SURFACES_DIFFUSE) { return material.base.color; }
    LobeAlbedos albedos = lobe_albedos(material, wo);
    return albedos.diffuse + albedos.specular;
}

// An estimate of the direct irradiance at a hit, from one light sample and a shadow ray in a medium.
vec3 sample_irradiance(SurfaceInteraction hit, Medium medium, inout uint rng) {
    if (scene_info.light_count == 0u) { return vec3(0.0); }
    ChosenLeaf chosen = choose_leaf(Receiver(hit.world_position, hit.geometric_world_normal), rng);
    ResolvedLightSample light_sample = resolve_light_sample(sample_leaf(chosen.leaf, rng), chosen.probability);
    LightContribution light = calculate_resolved_light_contribution(light_sample, hit.world_position);
    float cosine = dot(light.wi, hit.geometric_world_normal);
    vec3 irradiance = light.radiance_in_area_measure * (light.inverse_area_pdf * cosine);
    if (!(cosine > 0.0 && max_component(irradiance) > 0.0)) { return vec3(0.0); }
    vec3 origin = hit.world_position + hit.ray_offset * hit.geometric_world_normal;
    count_ray();
    return irradiance * trace_shadow_ray(origin, medium, for_shadow_ray(light_sample, light.wi));
}

const uint MAX_CACHE_MISSES = 4u;  // maximum of consecutive hits of a path for which the cache has no value

// The light along a ray, without the transmittance `through`: `emitted` + `reflectance` * `irradiance`.
struct GatheredLight {
    vec3 first_position;  // where the ray ended, moved off the surface; of a ray that met nothing its origin
    vec3 first_normal;    // geometric, there; 0 when that is a mirror or nothing
    vec3 emitted;         // by lights seen in mirrors
    vec3 reflectance;     // of the surface that the ray, or its reflections, met: radiance over irradiance
    vec3 irradiance;      // of that surface
    uint cell;            // in which that surface was looked up, or NO_INDEX
    RayTransmittance through;      // of the ray, to where it ended, its medium included
};

vec3 gathered_radiance(GatheredLight light) { return light.emitted + light.reflectance * light.irradiance; }

// The light that a surface reflects along a ray. What the surface emits is not included, since direct light counts
// it. `finest_for_short_rays`: see query_world_cache.
//
// Differs from Solari, which takes 0 where the cache has no value: here the path continues until the cache has one, so
// that no light is lost while cells appear and disappear.
GatheredLight gather_light(Walk walk, bool finest_for_short_rays, uint lifetime, inout uint rng) {
    GatheredLight light = GatheredLight(
        walk.origin, vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), NO_INDEX, FULL_TRANSMITTANCE
    );
    vec3 throughput = vec3(1.0);  // from the first surface on
    for (uint i = 0u; i <= MAX_CACHE_MISSES; i++) {
        SpecularChainHit found = trace_specular_chain(walk, rng);
        if (i == 0u) {
            light.first_position = found.first_position;
            light.emitted = found.emitted;
            light.through = found.first_transmittance;
        } else {
            throughput *= PI;  // the ray's cosine over its pdf
            throughput *= found.first_transmittance.weight;
            light.irradiance += throughput * found.emitted;
        }
        if (!found.exists) { break; }
        SurfaceInteraction hit = found.surface;
        vec3 albedo = surface_albedo(hit.material, -walk.direction * orthonormalize(hit.world_normal));
        vec3 reflectance = walk.throughput * (INVERSE_PI * albedo);
        float ray_t = finest_for_short_rays ? found.ray_t : INFINITY;
        if (i == 0u) {
            light.reflectance = reflectance;
            if (found.mirror_count == 0u) { light.first_normal = hit.geometric_world_normal; }
        } else {
            throughput *= reflectance;
        }
        WorldCacheResult cached =
            query_world_cache(hit.world_position, hit.geometric_world_normal, ray_t, lifetime, rng);
        if (i == 0u) { light.cell = cached.cell; }
        light.irradiance += throughput * (cached.found ? cached.irradiance : sample_irradiance(hit, walk.medium, rng));
        if (cached.found || frame_settings.world_cache == 0u) { break; }
        walk.direction = orthonormalize(hit.geometric_world_normal) * sample_cosine_hemisphere(rand_vec2f(rng));
        walk.throughput = vec3(1.0);
    }
    return light;
}

#endif
