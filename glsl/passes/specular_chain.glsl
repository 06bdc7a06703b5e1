// Rays that are reflected by metal mirrors, or go through glass, until they hit another surface, since the world cache
// holds irradiance, which says nothing of what these show. Differs from Solari, where all rays but those of specular GI
// see mirrors as white walls.
#ifndef PASSES_SPECULAR_CHAIN_GLSL
#define PASSES_SPECULAR_CHAIN_GLSL

#include "passes/bindings.glsl"
#include "passes/ray_count.glsl"
#include "scene/walk.glsl"

struct SpecularChainHit {
    bool exists;
    SurfaceInteraction surface;
    float ray_t;          // length of the last ray
    RayTransmittance first_transmittance;  // of the first ray, its medium included
    uint mirror_count;
    vec3 first_position;  // where the first ray ended, moved off the surface
    vec3 emitted;         // by lights seen in mirrors, which light samples can't find; throughput is applied
};

bool is_metal_mirror(ResolvedMaterial material) {
    return !lambertian_surfaces && material.base.metallic > frame_settings.pure_metal
        && material.base.roughness <= MIRROR_ROUGHNESS;
}

bool is_glass(ResolvedMaterial material) {
    return SCENE_GLASS && !lambertian_surfaces && material.glass.transmission > 0.0 && material.base.metallic < 1.0;
}

// Whether paths never end at this surface, but are reflected. Differs from Solari, where paths end at mirrors as at
// diffuse surfaces: world_cache_surfaces=diffuse.
bool continues_specular_chain(ResolvedMaterial material) {
    return world_cache_settings.surfaces == WORLD_CACHE_SURFACES_WHOLE
        && (is_metal_mirror(material) || is_glass(material));
}

// Whether a surface's reflection can't be computed from the irradiance of a cell, so that paths go on from it.
bool has_no_cell(ResolvedMaterial material) {
    return continues_specular_chain(material)
        || (world_cache_settings.surfaces == WORLD_CACHE_SURFACES_WHOLE && transmits(material));
}

// Afterwards walk.throughput has the reflectance of the mirrors and the transmittance of all rays but the first. Lights
// that the first ray hits are left out, since light samples find them.
SpecularChainHit trace_specular_chain(inout Walk walk, inout uint rng) {
    SpecularChainHit found;
    found.emitted = vec3(0.0);
    found.first_position = walk.origin;
    walk.mis_pdf = 0.0;
    for (found.mirror_count = 0u; found.mirror_count < MAX_DELTA_BOUNCES; found.mirror_count++) {
        Segment segment = trace_segment(walk, NO_RECEIVER, rng);
        count_rays(segment.rays);
        Medium medium = walk.medium;
        if (found.mirror_count == 0u) {
            found.first_transmittance = segment.transmittance;
            found.first_transmittance.weight *= transmittance(medium, segment.hit.t);
            segment.transmittance = FULL_TRANSMITTANCE;
            walk.medium = NO_MEDIUM;
        }
        found.exists = accumulate_segment(walk, segment, NO_RECEIVER, found.emitted);
        if (!found.exists) { return found; }
        found.surface = arrive_at_surface(walk, segment.hit);
        walk.medium = medium;
        found.ray_t = segment.hit.t;
        walk.origin = found.surface.world_position + found.surface.ray_offset * found.surface.geometric_world_normal;
        if (found.mirror_count == 0u) { found.first_position = walk.origin; }
        if (found.mirror_count > 0u) { found.emitted += emitted_light(walk, found.surface, 0.0); }
        if (!continues_specular_chain(found.surface.material)) { return found; }

        walk.mis_pdf = INFINITY;
        vec3 normal = found.surface.world_normal;
        if (!is_glass(found.surface.material)) {
            walk.throughput *= fresnel(found.surface.material.base.color, -dot(walk.direction, normal));
            walk.direction = reflect(walk.direction, normal);
            continue;
        }
        // Without Fresnel: all light is refracted, or reflected if that is total.
        walk.throughput *= found.surface.material.base.color;
        BaseMaterial base = found.surface.material.base;
        float ior = found.surface.material.glass.ior;
        Medium below = medium_below(segment.hit.instance, found.surface.material, walk.medium);
        vec3 bent = walk.direction;
        if (base.solid) { bent = refract(walk.direction, normal, base.inside ? ior : 1.0 / ior); }
        if (bent != vec3(0.0)) { walk.medium = below; }
        walk.direction = bent == vec3(0.0) ? reflect(walk.direction, normal) : normalize(bent);
        walk.origin = ray_origin(found.surface, walk.direction);
    }
    found.exists = false;
    return found;
}

#endif
