// What the light of a pixel's lobes is divided by, so that a denoiser blurs light and not textures.
#ifndef PASSES_PATHS_DEMODULATION_GLSL
#define PASSES_PATHS_DEMODULATION_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "scene/brdf.glsl"

struct Demodulation {
    vec3 diffuse;
    vec3 specular;
};

const float SMALLEST_DEMODULATION = 0.02;  // light of black surfaces is divided by it

Demodulation demodulation(GBufferSurface surface) {
    LobeAlbedos albedos = lobe_albedos(surface.material, max(dot(surface.world_normal, surface.wo), 0.0));
    return Demodulation(
        mix(vec3(SMALLEST_DEMODULATION), vec3(1.0), albedos.diffuse),
        mix(vec3(SMALLEST_DEMODULATION), vec3(1.0), albedos.specular)
    );
}

#endif
