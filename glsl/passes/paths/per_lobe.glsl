// Radiance, BRDF or weight, split into the diffuse and the specular lobe.
#ifndef PASSES_PATHS_PER_LOBE_GLSL
#define PASSES_PATHS_PER_LOBE_GLSL

struct PerLobe {
    vec3 diffuse;   // with sheen and diffuse transmission
    vec3 specular;  // with coat and glass
};

const PerLobe ZERO_LOBES = PerLobe(vec3(0.0), vec3(0.0));

PerLobe scale(PerLobe lobes, vec3 factor) {
    return PerLobe(lobes.diffuse * factor, lobes.specular * factor);
}
vec3 sum(PerLobe lobes) { return lobes.diffuse + lobes.specular; }

#endif
