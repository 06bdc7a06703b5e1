// A ray and what it meets past mirrors of metal, which the world cache's diffuse cells can't stand for.
// Differs from Solari, where mirrors are white walls to all rays but those of specular GI.
#ifndef PASSES_PAST_MIRRORS_GLSL
#define PASSES_PAST_MIRRORS_GLSL

#include "passes/bindings.glsl"
#include "passes/ray_count.glsl"
#include "scene/brdf.glsl"
#include "scene/sampling.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

const uint MOST_MIRRORS = 64u;

struct SightPastMirrors {
    bool found;                  // a surface that is no mirror
    ResolvedRayHitFull surface;
    vec3 direction;              // of the ray that met it
    float ray_t;                 // and its length
    vec3 throughput;             // of the mirrors on the way
    uint mirrors;
    vec3 first_position;         // where the first ray ended, moved off the surface
    vec3 emitted;                // by lights as mirrors show them, which no light sample can find; throughput included
};

bool is_metal_mirror(ResolvedMaterial material) {
    return !brdf_lambert && material.metallic > frame_settings.pure_metal && material.roughness <= MIRROR_ROUGHNESS;
}

// Whether a path that meets this surface is reflected by it and goes on, where others may end in the world cache.
// Differs from Solari, which has no such surfaces: world_cache_surfaces=diffuse.
bool is_passed_by(ResolvedMaterial material) {
    return world_cache_settings.surfaces == WORLD_CACHE_SURFACES_WHOLE && is_metal_mirror(material);
}

SightPastMirrors trace_past_mirrors(vec3 origin, vec3 direction, float t_max, float cone_width) {
    SightPastMirrors sight;
    sight.throughput = vec3(1.0);
    sight.emitted = vec3(0.0);
    sight.first_position = origin;
    for (sight.mirrors = 0u; sight.mirrors < MOST_MIRRORS; sight.mirrors++) {
        count_ray();
        Hit hit = trace_closest_hit(origin, 0.0, direction, t_max, TRACE_BOTH_FACES);
        sight.found = hit.instance != NO_INDEX;
        if (!sight.found) {
            if (sight.mirrors > 0u) { sight.emitted += sight.throughput * radiance_at_infinity(direction, INFINITY); }
            return sight;
        }
        sight.surface = resolve_ray_hit_full(hit, direction, cone_width);
        sight.direction = direction;
        sight.ray_t = hit.t;
        origin = sight.surface.world_position + sight.surface.ray_offset * sight.surface.geometric_world_normal;
        if (sight.mirrors == 0u) { sight.first_position = origin; }
        if (sight.mirrors > 0u && sight.surface.emits) { sight.emitted += sight.throughput * sight.surface.material.emissive; }
        if (!is_passed_by(sight.surface.material)) { return sight; }

        vec3 normal = sight.surface.world_normal;
        sight.throughput *= fresnel(sight.surface.material.base_color, -dot(direction, normal));
        direction = reflect(direction, normal);
    }
    sight.found = false;
    return sight;
}

#endif
