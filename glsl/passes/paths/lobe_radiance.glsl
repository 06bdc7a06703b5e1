// Radiance, BRDF or weight, split by lobe.
#ifndef PASSES_PATHS_LOBE_RADIANCE_GLSL
#define PASSES_PATHS_LOBE_RADIANCE_GLSL

struct LobeRadiance {
    vec3 diffuse;   // with sheen
    vec3 specular;  // by all other lobes: specular, coat and glass
};

const LobeRadiance NO_LIGHT = LobeRadiance(vec3(0.0), vec3(0.0));

LobeRadiance scale(LobeRadiance lobes, vec3 factor) {
    return LobeRadiance(lobes.diffuse * factor, lobes.specular * factor);
}
vec3 sum(LobeRadiance lobes) { return lobes.diffuse + lobes.specular; }

#endif
