// Debug views: what the passes left for a pixel, as a colour. They only read, so that they disturb no frame.
#ifndef PASSES_DISPLAY_VIEWS_GLSL
#define PASSES_DISPLAY_VIEWS_GLSL

#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/display/tonemap.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/guides/bindings.glsl"
#include "passes/light_tiles/light_tiles.glsl"
#include "passes/restir_di/bindings.glsl"
#include "passes/restir_gi/bindings.glsl"
#include "passes/world_cache/query.glsl"

// Rows of VIEWS in solari_vk/passes/display.py, which says what each shows.
const uint VIEW_PICTURE = 0u;
const uint VIEW_DI = 1u;
const uint VIEW_GI = 2u;
const uint VIEW_SPECULAR = 3u;
const uint VIEW_EMISSION = 4u;
const uint VIEW_DIFFUSE_RADIANCE = 5u;
const uint VIEW_SPECULAR_RADIANCE = 6u;
const uint VIEW_BASE_COLOR = 7u;
const uint VIEW_ROUGHNESS = 8u;
const uint VIEW_METALLIC = 9u;
const uint VIEW_REFLECTANCE = 10u;
const uint VIEW_EMISSIVE = 11u;
const uint VIEW_SHADING_NORMAL = 12u;
const uint VIEW_GEOMETRIC_NORMAL = 13u;
const uint VIEW_DEPTH = 14u;
const uint VIEW_INSTANCE = 15u;
const uint VIEW_MOTION = 16u;
const uint VIEW_LIGHT_TILES = 17u;
const uint VIEW_CACHE_CELLS = 18u;
const uint VIEW_CACHE_IRRADIANCE = 19u;
const uint VIEW_CACHE_SAMPLES = 20u;
const uint VIEW_CACHE_LIFE = 21u;
const uint VIEW_CACHE_LOD = 22u;
const uint VIEW_DI_LIGHT = 23u;
const uint VIEW_DI_CONFIDENCE = 24u;
const uint VIEW_DI_WEIGHT = 25u;
const uint VIEW_DI_VISIBILITY = 26u;
const uint VIEW_DI_NEIGHBOR = 27u;
const uint VIEW_GI_RADIANCE = 28u;
const uint VIEW_GI_CONFIDENCE = 29u;
const uint VIEW_GI_WEIGHT = 30u;
const uint VIEW_GUIDE_DIFFUSE_ALBEDO = 31u;
const uint VIEW_GUIDE_SPECULAR_ALBEDO = 32u;
const uint VIEW_GUIDE_NORMAL = 33u;
const uint VIEW_GUIDE_ROUGHNESS = 34u;
const uint VIEW_GUIDE_DEPTH = 35u;
const uint VIEW_GUIDE_SPECULAR_MOTION = 36u;

const vec3 NOTHING = vec3(0.0);
const vec3 ALARM = vec3(0.9, 0.1, 0.1);

// ---- colours of numbers -----------------------------------------------------------------------------

// From 0, dark blue, over green to 1, yellow: five of the colours of Viridis (van der Walt and Smith, 2015).
vec3 show_share(float share) {
    const vec3 colors[5] = vec3[](
        vec3(0.267, 0.005, 0.329), vec3(0.229, 0.322, 0.546), vec3(0.128, 0.567, 0.551), vec3(0.369, 0.789, 0.383),
        vec3(0.993, 0.906, 0.144)
    );
    float place = 4.0 * saturate(share);
    int first = min(int(place), 3);
    return mix(colors[first], colors[first + 1], place - float(first));
}

// Equal numbers, equal colours, never black.
vec3 show_number(uint number) { return 0.2 + 0.8 * unpack_4x8_unorm(pcg(number)).rgb; }

vec3 show_direction(vec3 direction) { return 0.5 + 0.5 * direction; }

// Grey stands still; red moves right or left, green down or up, by up to eight pixels.
vec3 show_motion(vec2 motion) { return vec3(0.5 - motion * vec2(uniforms.size) / 16.0, 0.5); }

// The colours begin anew wherever the distance doubles.
vec3 show_depth(float depth_value) {
    return depth_value > 0.0 ? show_share(fract(log2(uniforms.near / depth_value))) : NOTHING;
}

// ---- views of a pass --------------------------------------------------------------------------------

// Tile below tile, their samples from left to right.
vec3 show_light_tiles(uvec2 pixel) {
    uint samples_each = max(light_tiles.samples_each, 1u);
    uvec2 place = pixel * uvec2(samples_each, uint(light_tiles.at.length()) / samples_each) / uniforms.size;
    vec3 radiance = unpack_light_sample(light_tiles.at[place.y * samples_each + place.x]).radiance;
    return encode_srgb(radiance / max(max_component(radiance), 1e-30));  // lights themselves would all be white
}

// Of the surface's cell and its parts the first that there is, which need not be the one that this pixel asks.
vec3 show_cache(uvec2 pixel, GBufferSurface surface) {
    if (!surface.exists) { return NOTHING; }
    uint rng = seed_rng(pixel, 0u, 0u);
    float cell_size = get_cell_size(surface.world_position, rng);
    WorldCacheKey whole = make_world_cache_key(surface.world_position, surface.geometric_world_normal, cell_size), key = whole;
    uint empty_step;
    uint cell = find_world_cache_cell(key, empty_step);
    for (uint part = 2u; cell == NO_INDEX && part <= LANDMARKS; part++) {
        key = part_of_cell(whole, part);
        cell = find_world_cache_cell(key, empty_step);
    }
    if (uniforms.view == VIEW_CACHE_LOD) { return show_share(log2(cell_size / uniforms.world_cache_cell_size) / 8.0); }
    if (uniforms.view == VIEW_CACHE_CELLS) { return show_number(key.checksum) * (cell == NO_INDEX ? 0.2 : 1.0); }
    if (cell == NO_INDEX) { return NOTHING; }
    vec4 irradiance = world_cache_irradiance.at[cell];
    switch (uniforms.view) {
        case VIEW_CACHE_IRRADIANCE: return show_radiance(INVERSE_PI * irradiance.rgb);
        case VIEW_CACHE_SAMPLES: return show_share(irradiance.w / float(uniforms.world_cache_max_samples));
        default: return show_share(float(world_cache_life.at[cell]) / float(uniforms.world_cache_lifetime));
    }
}

// As the view of instances shows what glows, so that a light keeps its colour when others go.
vec3 show_light(LightSource light) {
    return show_number(light.kind == LIGHT_EMISSIVE_MESH ? instances.at[light.index].id : ~light.index);
}

vec3 show_di(uint index) {
    DiReservoir reservoir = di_reservoirs.at[index];
    if (uniforms.view == VIEW_DI_CONFIDENCE) { return show_share(reservoir.confidence / (2.0 * uniforms.di_confidence_cap)); }
    if (uniforms.view == VIEW_DI_NEIGHBOR) { return di_outcomes.at[index].x == NO_INDEX ? ALARM : vec3(0.5); }
    if (reservoir.light_sample.light_index == NO_INDEX) { return NOTHING; }
    switch (uniforms.view) {
        case VIEW_DI_LIGHT: return show_light(light_sources.at[reservoir.light_sample.light_index]);
        case VIEW_DI_WEIGHT: return show_share(log2(1.0 + reservoir.unbiased_contribution_weight) / 12.0);
        default: return di_outcomes.at[index].y != 0u ? vec3(1.0) : vec3(0.25);
    }
}

vec3 show_gi(uint index) {
    GiReservoir reservoir = gi_reservoirs.at[index];
    switch (uniforms.view) {
        case VIEW_GI_CONFIDENCE: return show_share(reservoir.confidence_weight / (2.0 * uniforms.gi_confidence_cap));
        case VIEW_GI_WEIGHT: return show_share(reservoir.unbiased_contribution_weight / (4.0 * PI));
        default: return show_radiance(reservoir.radiance);
    }
}

// ---- the chosen one ---------------------------------------------------------------------------------

// As an 8-bit picture holds it.
vec3 show_view(uvec2 pixel) {
    ivec2 at = ivec2(pixel);
    uint index = pixel.y * uniforms.size.x + pixel.x;
    GBufferSurface surface = load_gbuffer(pixel);
    switch (uniforms.view) {
        case VIEW_DI: return show_radiance(di_diffuse.at[index] + di_specular.at[index]);
        case VIEW_GI: return show_radiance(gi_diffuse.at[index]);
        case VIEW_SPECULAR: return show_radiance(specular_gi.at[index]);
        case VIEW_EMISSION: return show_radiance(emission.at[index]);
        case VIEW_DIFFUSE_RADIANCE: return show_radiance(diffuse_radiance.at[index]);
        case VIEW_SPECULAR_RADIANCE: return show_radiance(specular_radiance.at[index]);

        case VIEW_BASE_COLOR: return encode_srgb(surface.material.base_color);
        case VIEW_ROUGHNESS: return vec3(surface.material.perceptual_roughness);
        case VIEW_METALLIC: return vec3(surface.material.metallic);
        case VIEW_REFLECTANCE: return surface.material.reflectance;
        case VIEW_EMISSIVE: return show_radiance(surface.material.emissive);
        case VIEW_SHADING_NORMAL: return surface.exists ? show_direction(surface.world_normal) : NOTHING;
        case VIEW_GEOMETRIC_NORMAL: return surface.exists ? show_direction(surface.geometric_world_normal) : NOTHING;
        case VIEW_DEPTH: return show_depth(imageLoad(depth, at).x);
        case VIEW_INSTANCE: return surface.exists ? show_number(instances.at[surface.instance].id) : NOTHING;
        case VIEW_MOTION: return show_motion(imageLoad(motion_vectors, at).xy);

        case VIEW_LIGHT_TILES: return show_light_tiles(pixel);

        case VIEW_CACHE_CELLS:
        case VIEW_CACHE_IRRADIANCE:
        case VIEW_CACHE_SAMPLES:
        case VIEW_CACHE_LIFE:
        case VIEW_CACHE_LOD: return show_cache(pixel, surface);

        case VIEW_DI_LIGHT:
        case VIEW_DI_CONFIDENCE:
        case VIEW_DI_WEIGHT:
        case VIEW_DI_VISIBILITY:
        case VIEW_DI_NEIGHBOR: return surface.exists ? show_di(index) : NOTHING;

        case VIEW_GI_RADIANCE:
        case VIEW_GI_CONFIDENCE:
        case VIEW_GI_WEIGHT: return surface.exists ? show_gi(index) : NOTHING;

        case VIEW_GUIDE_DIFFUSE_ALBEDO: return encode_srgb(imageLoad(guides_diffuse_albedo, at).rgb);
        case VIEW_GUIDE_SPECULAR_ALBEDO: return encode_srgb(imageLoad(guides_specular_albedo, at).rgb);
        case VIEW_GUIDE_NORMAL: return surface.exists ? show_direction(imageLoad(guides_normal_roughness, at).xyz) : NOTHING;
        case VIEW_GUIDE_ROUGHNESS: return vec3(imageLoad(guides_normal_roughness, at).w);
        case VIEW_GUIDE_DEPTH: return show_depth(imageLoad(guides_depth, at).x);
        case VIEW_GUIDE_SPECULAR_MOTION: return show_motion(imageLoad(guides_specular_motion, at).xy);

        default: return show_radiance(radiance.at[index]);
    }
}

#endif
