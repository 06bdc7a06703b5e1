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

const float MIN_DEMODULATION = 0.02;  // for black surfaces

Demodulation demodulation(GBufferSurface surface) {
    vec3 wo = surface.wo * orthonormalize(surface.world_normal);
    LobeAlbedos albedos = lobe_albedos(surface.material, vec3(wo.xy, max(wo.z, 0.0)));
    return Demodulation(
        mix(vec3(MIN_DEMODULATION), vec3(1.0), albedos.diffuse),
        mix(vec3(MIN_DEMODULATION), vec3(1.0), albedos.specular)
    );
}

#endif
