// Light by the diffuse and by the specular lobe of a surface.
#ifndef PASSES_PATHS_LOBES_GLSL
#define PASSES_PATHS_LOBES_GLSL

struct Lobes {
    vec3 diffuse;
    vec3 specular;
};

const Lobes NO_LIGHT = Lobes(vec3(0.0), vec3(0.0));

Lobes scale(Lobes lobes, vec3 factor) { return Lobes(lobes.diffuse * factor, lobes.specular * factor); }
vec3 sum(Lobes lobes) { return lobes.diffuse + lobes.specular; }

#endif
