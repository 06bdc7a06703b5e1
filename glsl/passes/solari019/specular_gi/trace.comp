// Specular GI: the light that the specular lobe of a pixel's surface reflects. Rough surfaces reuse the sample of
// ReSTIR GI. Smooth surfaces trace a short path, with light and BRDF samples weighted by the power heuristic (Veach
// 1997); it ends in the world cache when its cone is wider than a cell.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/camera_medium.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/specular_chain.glsl"
#include "passes/ray_count.glsl"
#include "passes/solari019/restir_gi/reservoir.glsl"
#include "passes/solari019/specular_gi/cone_spread.glsl"
#include "passes/world_cache/query.glsl"
#include "scene/walk.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint SPECULAR_GI_SALT = 0x5BEC9141u;

// ---- the path ---------------------------------------------------------------------------------------

// How far light in a cell of the world cache may be from that of a point, which the width of the path's cone tells.
struct Cone {
    float spread;  // the squared slope of the cone: the sum of cone_spread_of_lobe
    float width;
};

void spread(inout Cone cone, BrdfSample next, float roughness) {
    cone.spread += next.diffuse ? cone_spread_of_lobe(1.0)
        : next.pdf == INFINITY ? 0.0 : cone_spread_of_lobe(roughness);
}

// Solari's rule for the cone's width: over each ray, the square of the width grows by the spread of the lobe at the
// ray's end.
float widen_as_solari(float spread_width, float ray_t, float roughness) {
    return sqrt(square(spread_width) + square(ray_t) * solari_cone_spread_of_lobe(roughness));
}

// Whether a path may end in the world cache: its cone is wider and its last ray longer than a cell, so that cells
// don't show.
bool may_end(SurfaceInteraction surface, float spread_width, float ray_t, inout uint rng) {
    float cell_size = get_cell_size(surface.world_position, rng);
    bool as_solari = specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD;
    return spread_width > cell_size && ray_t > (as_solari ? sqrt(3.0) : 1.0) * cell_size;
}

// The radiance that arrives along the path's first ray, and that ray's length.
vec3 trace_path(Walk walk, Cone cone, inout uint rng, out float first_t) {
    vec3 radiance = vec3(0.0);
    Receiver receiver = NO_RECEIVER;  // where the light samples were chosen that compete with the walk's direction
    first_t = 0.0;
    uint visited = 0u, mirrors = 0u;
    bool as_solari = specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD;
    while (true) {
        Segment segment = trace_segment(walk, receiver, rng);
        count_rays(segment.rays);
        first_t = first_t == 0.0 ? segment.hit.t : first_t;
        if (!accumulate_segment(walk, segment, receiver, radiance)) { return radiance; }
        float ray_t = segment.hit.t;
        if (!as_solari) { cone.width += sqrt(cone.spread) * ray_t; }
        SurfaceInteraction surface = arrive_at_surface(walk, segment.hit);
        remove_straight_transmission(segment.hit, walk.direction, surface.material, walk.throughput);
        radiance += emitted_light(walk, surface, hit_light_pdf(receiver, segment.hit, surface, walk.direction));

        bool mirror = continues_specular_chain(surface.material);
        mirrors += mirror ? 1u : 0u;
        visited += mirror ? 0u : 1u;
        WorldCacheResult end = NO_CELL;
        if (!mirror && (visited >= specular_gi_settings.bounces || may_end(surface, cone.width, ray_t, rng))) {
            // Differs from Solari, where only the first ray of GI asks the finest cells if it is short.
            end = query_world_cache(
                surface.world_position, surface.geometric_world_normal, ray_t, world_cache_settings.lifetime, rng
            );
        }
        // Differs from Solari: where the cache has no value, the path continues.
        uint max_visited = specular_gi_settings.bounces + (frame_settings.world_cache != 0u ? MAX_CACHE_MISSES : 0u);
        if (mirrors > MAX_DELTA_BOUNCES) { return radiance; }
        if (!end.found && visited >= max_visited) {
            end = WorldCacheResult(NO_INDEX, true, sample_irradiance(surface, walk.medium, rng));
        }
        mat3 frame = orthonormalize(surface.world_normal);
        vec3 wo = -walk.direction * frame;
        if (end.found) {
            return radiance + walk.throughput * INVERSE_PI * surface_albedo(surface.material, wo) * end.irradiance;
        }

        Brdf brdf = prepare_brdf(surface.material, wo);
        Medium below = medium_below(segment.hit.instance, surface.material, walk.medium);
        receiver = Receiver(surface.world_position, surface.world_normal);
        NextEvent event;
        event.radiance = vec3(0.0);
        if (!is_delta(brdf)) {
            event = sample_light(walk, surface, brdf, frame, wo, below, receiver, true, rng);
        }
        // Differs from Solari: later bounces sample the whole BRDF, so that matte surfaces need no MIS of their own.
        BrdfSample next = sample_brdf(brdf, wo, rng);
        spread(cone, next, brdf.specular.roughness);
        bool valid = scatter(walk, next, frame, surface.geometric_world_normal, surface.lift, below);
        walk.origin = ray_origin(surface, walk.direction);
        if (as_solari) { cone.width = widen_as_solari(cone.width, ray_t, surface.material.base.roughness); }
        // last, when the surface isn't needed any more
        if (max_component(event.radiance) > 0.0) {
            count_ray();
            radiance += event.radiance * trace_shadow_ray(event.origin, event.medium, event.light_sample);
        }
        float survival_probability = max_component(walk.throughput);
        if (!(valid && survival_probability > 0.0)) { return radiance; }
        uint bounce = visited + mirrors;
        if (bounce >= FIRST_ROULETTE_BOUNCE && !survives(walk, survival_probability, bounce, rng)) { return radiance; }
    }
}

// ---- rough surfaces ---------------------------------------------------------------------------------

// Whether the pixel reuses the sample of ReSTIR GI. That sample contains no direct light, so DI must shade the specular
// lobe too.
bool reuses_gi(GBufferSurface surface) {
    float roughness = surface.material.base.roughness;
    return roughness > max(specular_gi_settings.reuse_roughness, specular_gi_settings.di_roughness)
        && !takes_no_gi(surface);
}

vec3 shade_gi_sample(
    GBufferSurface surface, GiReservoir reservoir, Brdf brdf, mat3 frame, vec3 wo, out float distance
) {
    distance = 0.0;
    if (!(reservoir.unbiased_contribution_weight > 0.0)) { return vec3(0.0); }
    vec3 to_sample = reservoir.sample_point_world_position - surface.world_position;
    distance = length(to_sample);
    vec3 wi = to_sample / distance * frame;
    return gi_radiance(surface, reservoir) * reservoir.unbiased_contribution_weight
        * evaluate_specular_brdf(brdf, wo, wi);
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    specular_gi.at[index] = vec3(0.0);
    specular_gi_distances.at[index] = 0.0;
    GBufferSurface surface = load_gbuffer(pixel);
    if (solari019_settings.specular == 0u || !surface.exists) { return; }

    mat3 frame = orthonormalize(surface.world_normal);
    vec3 wo = surface.wo * frame;
    Brdf brdf = prepare_brdf(surface.material, wo);
    if (brdf.specular_probability == 0.0) { return; }
    if (reuses_gi(surface)) {
        float distance;
        specular_gi.at[index] = shade_gi_sample(surface, load_gi_reservoir(pixel), brdf, frame, wo, distance);
        specular_gi_distances.at[index] = distance;
        return;
    }

    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ SPECULAR_GI_SALT);
    BrdfSample next = sample_specular_brdf(brdf, wo, rng);
    CameraRay camera_ray = make_camera_ray(vec2(pixel) + 0.5);
    float distance = length(surface.world_position - camera_ray.origin);
    Walk walk = start_walk(camera_ray);
    walk.cone_width += walk.cone_spread * distance;
    walk.medium = camera_medium();
    Medium below = medium_below(surface.instance, surface.material, walk.medium);
    bool valid = scatter(walk, next, frame, surface.geometric_world_normal, surface.lift, below);
    if (!(valid && max_component(walk.throughput) > 0.0)) { return; }
    walk.origin = ray_origin(
        surface.world_position, surface.geometric_world_normal, surface.ray_offset, surface.lift, walk.direction
    );
    walk.mis_pdf = surface.material.base.roughness <= specular_gi_settings.di_roughness ? INFINITY : 0.0;
    Cone cone = Cone(0.0, 0.0);
    spread(cone, next, brdf.specular.roughness);
    if (specular_gi_settings.termination == SPECULAR_TERMINATION_CAMERA_SPREAD) {
        cone.width = widen_as_solari(0.0, distance, surface.material.base.roughness);
    }
    float first_t;
    specular_gi.at[index] = trace_path(walk, cone, rng, first_t);
    specular_gi_distances.at[index] = first_t;
}
