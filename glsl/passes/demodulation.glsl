// What the light of a pixel's lobes is divided by, so that a denoiser blurs light and not textures: the lobes' albedos,
// bounded from below.
#ifndef PASSES_DEMODULATION_GLSL
#define PASSES_DEMODULATION_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "scene/brdf.glsl"

struct Demodulation {
    vec3 diffuse;
    vec3 specular;
};

// For black surfaces. Diffuse light is in proportion to its albedo, so that the bound may be low. Fresnel's term of a
// dark color depends on where light comes from, and the albedo is its mean.
const float MIN_DIFFUSE = 1e-4;
const float MIN_SPECULAR = 5e-3;

Demodulation demodulation(GBufferSurface surface) {
    vec3 wo = surface.wo * orthonormalize(surface.world_normal);
    LobeAlbedos albedos = lobe_albedos(surface.material, vec3(wo.xy, max(wo.z, 0.0)));
    return Demodulation(
        mix(vec3(MIN_DIFFUSE), vec3(1.0), albedos.diffuse),
        mix(vec3(MIN_SPECULAR), vec3(1.0), albedos.specular)
    );
}

#endif
