// Light by the diffuse and by the specular lobe of a surface.
#ifndef PASSES_PATHS_LOBE_RADIANCE_GLSL
#define PASSES_PATHS_LOBE_RADIANCE_GLSL

struct LobeRadiance {
    vec3 diffuse;
    vec3 specular;
};

const LobeRadiance NO_LIGHT = LobeRadiance(vec3(0.0), vec3(0.0));

LobeRadiance scale(LobeRadiance lobes, vec3 factor) {
    return LobeRadiance(lobes.diffuse * factor, lobes.specular * factor);
}
vec3 sum(LobeRadiance lobes) { return lobes.diffuse + lobes.specular; }

#endif
