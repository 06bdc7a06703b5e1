// The solids in which light goes, which absorb it.
#ifndef SCENE_MEDIUM_GLSL
#define SCENE_MEDIUM_GLSL

#include "scene/bindings.glsl"

// The solid in which a ray is, by its material; NO_INDEX: none. Thin-walled glass is no solid.
struct Medium {
    uint material;
    uint around;  // the solid around that one, into which a ray leaves it
};

const Medium NO_MEDIUM = Medium(NO_INDEX, NO_INDEX);

// Beer-Lambert transmittance of a distance in a medium.
vec3 transmittance(Medium medium, float distance) {
    if (!SCENE_ABSORPTION || medium.material == NO_INDEX) { return vec3(1.0); }
    vec3 absorption = materials.at[medium.material].absorption;
    return mix(exp(-absorption * distance), vec3(1.0), equal(absorption, vec3(0.0)));
}

#endif
