// What becomes of light at the surface that a ray meets: the share that comes back along the ray, as sensors see it
// that send light out themselves, and the share that goes straight on.
#ifndef PASSES_RAY_TRACER_BACKSCATTER_GLSL
#define PASSES_RAY_TRACER_BACKSCATTER_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "scene/brdf.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"
#include "scene/walk.glsl"

struct Echo {
    vec3 backscatter;  // the BRDF towards where the light came from, times the cosine, in 1/sr
    vec3 passed;       // the share of light that goes straight on; both with what solids before the surface absorb
};

const Echo NO_ECHO = Echo(vec3(0.0), vec3(1.0));

layout(set = 1, scalar) writeonly buffer RayEchoesBlock { Echo at[]; } ray_echoes;

// Solid glass refracts what passes; the share is that of light that goes straight on, as through a pane.
vec3 passed_by_glass(ResolvedMaterial material, float cosine) {
    float share = material.glass.transmission * (1.0 - material.base.metallic);
    return material.base.color * share * (1.0 - dielectric_fresnel(material.glass.ior, cosine));
}

// `way`: from where the ray starts to the surface. A solid on it absorbs light there and back.
Echo find_echo(Hit hit, vec3 origin, vec3 way) {
    vec3 direction = normalize(way);
    SurfaceInteraction surface = resolve_surface_interaction(hit, direction, 0.0);
    ResolvedMaterial material = surface.material;
    vec4 filter_opacity = resolve_filter_opacity(hit.instance, hit.triangle, hit.barycentrics, direction, false);
    RayTransmittance through = FULL_TRANSMITTANCE;
    attenuate_by_surface(through, filter_opacity);
    Echo echo = Echo(vec3(0.0), through.weight * through.probability);
    float opacity = filter_opacity.w;
    vec3 wo = -direction * orthonormalize(surface.world_normal);
    if (SCENE_GLASS) {
        if ((materials.at[instances.at[hit.instance].material].flags & MATERIAL_WALL) != 0u) {
            material.glass.reflects_only = opacity < 1.0;
            opacity = 1.0;
        } else if (material.base.solid && opacity >= 1.0) {
            echo.passed = passed_by_glass(material, wo.z);
        }
    }
    Brdf brdf = prepare_brdf(material, wo);
    vec3 arrives = transmittance(find_medium(origin + 0.5 * way), length(way));
    echo.passed *= arrives;
    echo.backscatter = opacity * arrives * arrives * brdf_times_cosine(brdf, wo, wo);
    return echo;
}

#endif
