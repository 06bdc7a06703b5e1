// Rays that are reflected by metal mirrors, or pass glass, until they hit another surface, since the world cache's
// diffuse cells can't stand for these. Differs from Solari, where all rays but those of specular GI see mirrors as
// white walls.
#ifndef PASSES_PAST_MIRRORS_GLSL
#define PASSES_PAST_MIRRORS_GLSL

#include "passes/bindings.glsl"
#include "passes/ray_count.glsl"
#include "scene/brdf.glsl"
#include "scene/departure.glsl"
#include "scene/light_visibility.glsl"
#include "scene/sampling.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

const uint MAX_MIRRORS = 64u;

struct HitPastMirrors {
    bool exists;
    ResolvedRayHitFull surface;
    vec3 direction;       // of the last ray, which hit `surface`
    float ray_t;          // length of the last ray
    vec3 throughput;      // product of the mirrors' reflectances, and of the tints of all rays but the first
    Passage first_passage;  // of the first ray
    uint mirror_count;
    vec3 first_position;  // where the first ray ended, moved off the surface
    vec3 emitted;         // light of lights seen in mirrors, which light samples can't find; includes throughput
};

bool is_metal_mirror(ResolvedMaterial material) {
    return !brdf_lambert && material.metallic > frame_settings.pure_metal && material.roughness <= MIRROR_ROUGHNESS;
}

bool is_glass(ResolvedMaterial material) {
    return SCENE_GLASS && !brdf_lambert && material.lobes.transmission > 0.0 && material.metallic < 1.0;
}

// Whether paths never end at this surface, but are reflected. Differs from Solari, where paths end at mirrors as at
// diffuse surfaces: world_cache_surfaces=diffuse.
bool always_reflects(ResolvedMaterial material) {
    return world_cache_settings.surfaces == WORLD_CACHE_SURFACES_WHOLE
        && (is_metal_mirror(material) || is_glass(material));
}

HitPastMirrors trace_past_mirrors(vec3 origin, vec3 direction, float t_max, float cone_width, inout uint rng) {
    HitPastMirrors found;
    found.throughput = vec3(1.0);
    found.emitted = vec3(0.0);
    found.first_position = origin;
    for (found.mirror_count = 0u; found.mirror_count < MAX_MIRRORS; found.mirror_count++) {
        count_ray();
        Hit hit = trace_closest_hit(origin, 0.0, direction, t_max, TRACE_BOTH_FACES, random_blend_point(rng));
        if (SCENE_BLEND) { count_ray(); }
        Passage passage = trace_passage(origin, direction, t_max, hit);
        if (found.mirror_count == 0u) {
            found.first_passage = passage;
        } else {
            float t_end = min(hit.t, t_max);
            uint lamp_rays;
            found.emitted += found.throughput * trace_radiance_passed(origin, direction, t_end, INFINITY, lamp_rays);
            count_rays(lamp_rays);
            found.throughput *= passage.tint;
        }
        found.exists = hit.instance != NO_INDEX;
        if (!found.exists) {
            if (found.mirror_count > 0u) {
                found.emitted += found.throughput * radiance_at_infinity(direction, INFINITY);
            }
            return found;
        }
        found.surface = resolve_ray_hit_full(hit, direction, cone_width);
        found.direction = direction;
        found.ray_t = hit.t;
        origin = found.surface.world_position + found.surface.ray_offset * found.surface.geometric_world_normal;
        if (found.mirror_count == 0u) { found.first_position = origin; }
        if (found.mirror_count > 0u && found.surface.emits) {
            found.emitted += found.throughput * found.surface.material.emissive;
        }
        if (!always_reflects(found.surface.material)) { return found; }

        vec3 normal = found.surface.world_normal;
        if (is_glass(found.surface.material)) {
            // All light takes the way through the glass, since one ray can't take two.
            MaterialLobes lobes = found.surface.material.lobes;
            if (lobes.inside) { found.throughput *= attenuation(lobes.absorption, hit.t); }
            found.throughput *= found.surface.material.base_color;
            vec3 bent = direction;
            if (lobes.solid) { bent = refract(direction, normal, lobes.inside ? lobes.ior : 1.0 / lobes.ior); }
            direction = bent == vec3(0.0) ? reflect(direction, normal) : normalize(bent);
            origin = ray_origin(found.surface, direction);
            continue;
        }
        found.throughput *= fresnel(found.surface.material.base_color, -dot(direction, normal));
        direction = reflect(direction, normal);
    }
    found.exists = false;
    return found;
}

#endif
