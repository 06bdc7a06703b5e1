// Specular GI: the light that the specular lobe of a pixel's surface reflects. Rough surfaces reuse the sample of
// ReSTIR GI. Smooth surfaces trace a short path, with light and BRDF samples weighted by the power heuristic (Veach
// 1997); it ends in the world cache when its cone is wider than a cell.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/past_mirrors.glsl"
#include "passes/ray_count.glsl"
#include "passes/restir_gi/reservoir.glsl"
#include "passes/specular_gi/lobe.glsl"
#include "passes/world_cache/query.glsl"
#include "scene/brdf.glsl"
#include "scene/light_visibility.glsl"
#include "scene/sampling.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint SPECULAR_GI_SALT = 0x5BEC9141u;
const uint FIRST_ROULETTE_SURFACE = 3u;

// ---- lights -----------------------------------------------------------------------------------------

// The light of a random light sample by the whole BRDF, without visibility, with its MIS weight against hitting the
// light by the next ray.
vec3 sample_light(
    ResolvedRayHitFull surface, Brdf brdf, mat3 frame, vec3 wo, inout uint rng, out ResolvedLightSample light_sample,
    out vec3 origin
) {
    if (scene_info.light_count == 0u) { return vec3(0.0); }
    light_sample = resolve_light_sample(generate_random_light_sample(rng));
    LightContribution light = calculate_resolved_light_contribution(light_sample, surface.world_position);
    vec3 wi = light.wi * frame;
    if (!is_possible(wi.z, light.wi, surface.geometric_world_normal)) { return vec3(0.0); }
    origin = ray_origin(surface, light.wi);
    return light.received_radiance * light.inverse_pdf * evaluate_brdf(brdf, wo, wi)
        * power_heuristic(light.solid_angle_pdf, brdf_pdf(brdf, wo, wi));
}

// ---- the path ---------------------------------------------------------------------------------------

// The state of a path between two surfaces.
struct Path {
    vec3 origin;
    vec3 direction;
    vec3 throughput;
    float bounce_pdf;    // of `direction`, for MIS; INFINITY: only this path finds lights, 0: DI finds them
    float spread;        // the squared slope of the path's cone: the sum of lobe_spread
    float spread_width;  // the width of the path's cone
};

// Continues the path from a surface in a sampled direction. Returns false when the path carries no light.
bool leave_surface(inout Path path, BrdfSample next, Brdf brdf, mat3 frame, vec3 geometric_world_normal) {
    path.direction = normalize(frame * next.wi);
    path.throughput *= next.weight;
    path.bounce_pdf = next.pdf;
    path.spread += next.diffuse ? lobe_spread(1.0) : next.pdf == INFINITY ? 0.0 : lobe_spread(brdf.roughness);
    return is_possible(next.wi.z, path.direction, geometric_world_normal) && max_component(path.throughput) > 0.0;
}

// Solari's rule for the cone's width: over each ray, the square of the width grows by the spread of the lobe at the
// ray's end.
float widen_as_solari(float spread_width, float ray_t, float roughness) {
    return sqrt(square(spread_width) + square(ray_t) * solari_lobe_spread(roughness));
}

// Whether a path may end in the world cache: its cone is wider and its last ray longer than a cell, so that cells
// don't show.
bool may_end(ResolvedRayHitFull surface, float spread_width, float ray_t, inout uint rng) {
    float cell_size = get_cell_size(surface.world_position, rng);
    bool as_solari = specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD;
    return spread_width > cell_size && ray_t > (as_solari ? sqrt(3.0) : 1.0) * cell_size;
}

// The radiance that arrives along the path's first ray. `distance` is the distance from the camera to its origin.
vec3 trace_path(Path path, float distance, CameraRay camera_ray, inout uint rng) {
    vec3 radiance = vec3(0.0);
    uint visited = 0u, mirrors = 0u;
    bool as_solari = specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD;
    while (true) {
        count_ray();
        uvec2 blend_point = random_blend_point(rng);
        Hit hit = trace_closest_hit(path.origin, 0.0, path.direction, INFINITY, TRACE_BOTH_FACES, blend_point);
        if (SCENE_BLEND) { count_ray(); }
        uint lamp_rays;
        radiance += path.throughput
            * trace_radiance_passed(path.origin, path.direction, hit.t, path.bounce_pdf, lamp_rays);
        count_rays(lamp_rays);
        path.throughput *= trace_passage(path.origin, path.direction, INFINITY, hit).tint;
        if (hit.instance == NO_INDEX) {
            return radiance + path.throughput * radiance_at_infinity(path.direction, path.bounce_pdf);
        }
        distance += hit.t;
        if (!as_solari) { path.spread_width += sqrt(path.spread) * hit.t; }
        ResolvedRayHitFull surface = resolve_ray_hit_full(
            hit, path.direction, camera_ray.cone_width + camera_ray.cone_spread * distance
        );
        if (surface.emits) {
            float light_pdf = emissive_hit_pdf(surface, path.direction, hit.t);
            radiance += path.throughput * surface.material.emissive * power_heuristic(path.bounce_pdf, light_pdf);
        }
        take_wall_as_met(hit, path.direction, surface.material, path.throughput);
        if (SCENE_GLASS && surface.material.lobes.inside) {
            path.throughput *= attenuation(surface.material.lobes.absorption, hit.t);
        }

        bool mirror = always_reflects(surface.material);
        mirrors += mirror ? 1u : 0u;
        visited += mirror ? 0u : 1u;
        WorldCacheResult end = NO_CELL;
        if (!mirror && (visited >= specular_gi_settings.bounces || may_end(surface, path.spread_width, hit.t, rng))) {
            end = query_world_cache(
                surface.world_position, surface.geometric_world_normal, hit.t, world_cache_settings.lifetime, rng
            );
        }
        // Differs from Solari: where the cache has no value, the path continues.
        uint max_visited = specular_gi_settings.bounces + (frame_settings.world_cache != 0u ? MAX_CACHE_MISSES : 0u);
        if (mirrors > MAX_MIRRORS) { return radiance; }
        if (!end.found && visited >= max_visited) {
            end = WorldCacheResult(NO_INDEX, true, sample_irradiance(surface, rng));
        }
        mat3 frame = orthonormalize(surface.world_normal);
        vec3 wo = -path.direction * frame;
        if (end.found) {
            return radiance + path.throughput * INVERSE_PI * surface_albedo(surface.material, wo.z) * end.irradiance;
        }

        Brdf brdf = prepare_brdf(surface.material, wo);
        vec3 direct = vec3(0.0), shadow_origin;
        ResolvedLightSample light_sample;
        if (!brdf.mirror || brdf.specular_probability < 1.0) {
            direct = path.throughput * sample_light(surface, brdf, frame, wo, rng, light_sample, shadow_origin);
        }
        BrdfSample next = sample_brdf(brdf, wo, rng);
        bool goes_on = leave_surface(path, next, brdf, frame, surface.geometric_world_normal);
        path.origin = ray_origin(surface, path.direction);
        if (as_solari) { path.spread_width = widen_as_solari(path.spread_width, hit.t, surface.material.roughness); }
        // last, when the surface isn't needed any more
        if (max_component(direct) > 0.0) {
            count_ray();
            radiance += direct * trace_light_transmittance(shadow_origin, light_sample);
        }
        if (!goes_on) { return radiance; }
        if (visited + mirrors >= FIRST_ROULETTE_SURFACE) {
            float survival = min(max_component(path.throughput), 1.0);
            if (rand_f(rng) >= survival) { return radiance; }
            path.throughput /= survival;
        }
    }
}

// ---- rough surfaces ---------------------------------------------------------------------------------

// Whether the pixel reuses the sample of ReSTIR GI. That sample contains no direct light, so DI must shade the specular
// lobe too.
bool reuses_gi(GBufferSurface surface) {
    return surface.material.roughness > max(specular_gi_settings.reuse_roughness, specular_gi_settings.di_roughness)
        && !takes_no_gi(surface);
}

vec3 shade_gi_sample(GBufferSurface surface, GiReservoir reservoir, Brdf brdf, mat3 frame, vec3 wo) {
    if (!(reservoir.unbiased_contribution_weight > 0.0)) { return vec3(0.0); }
    vec3 wi = normalize(reservoir.sample_point_world_position - surface.world_position) * frame;
    return gi_radiance(reservoir) * reservoir.unbiased_contribution_weight * evaluate_specular_brdf(brdf, wo, wi);
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    specular_gi.at[index] = vec3(0.0);
    GBufferSurface surface = load_gbuffer(pixel);
    if (frame_settings.specular == 0u || !surface.exists) { return; }

    mat3 frame = orthonormalize(surface.world_normal);
    vec3 wo = surface.wo * frame;
    Brdf brdf = prepare_brdf(surface.material, wo);
    if (brdf.specular_probability == 0.0) { return; }
    if (reuses_gi(surface)) {
        specular_gi.at[index] = shade_gi_sample(surface, load_gi_reservoir(pixel), brdf, frame, wo);
        return;
    }

    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ SPECULAR_GI_SALT);
    BrdfSample next = sample_specular_brdf(brdf, wo, rng);
    vec3 origin = surface.world_position + surface.geometric_world_normal * surface.ray_offset;
    Path path = Path(origin, -surface.wo, vec3(1.0), 0.0, 0.0, 0.0);
    if (!leave_surface(path, next, brdf, frame, surface.geometric_world_normal)) { return; }
    path.bounce_pdf = surface.material.roughness <= specular_gi_settings.di_roughness ? INFINITY : 0.0;
    CameraRay camera_ray = make_camera_ray(vec2(pixel) + 0.5);
    float distance = length(surface.world_position - camera_ray.origin);
    if (specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD) {
        path.spread_width = widen_as_solari(0.0, distance, surface.material.roughness);
    }
    specular_gi.at[index] = trace_path(path, distance, camera_ray, rng);
}
