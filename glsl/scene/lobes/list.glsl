// The lobes that few materials have, listed once: scene/material.glsl and scene/brdf.glsl loop over these lists.
//
// A row is DO(its name, its type seen from a direction, its parameters, those of a material without it, the scene
// feature that it needs, the type of its bits in the G-buffer). Each lobe's file ends with the functions that the loops
// call, which have the same names for all lobes and are told apart by the types of their arguments. A new lobe is a
// file and a row here; a new layer also has its place in both orders below.
#ifndef SCENE_LOBES_LIST_GLSL
#define SCENE_LOBES_LIST_GLSL

#include "scene/lobes/coat.glsl"
#include "scene/lobes/diffuse_transmission.glsl"
#include "scene/lobes/glass.glsl"
#include "scene/lobes/sheen.glsl"

// Layers lie over all other lobes, the first at the top. Only the topmost may be a mirror, since nothing takes from the
// light of a mirror what layers above it reflect.
#define LAYER_1(DO) DO(coat, Coat, CoatParameters, NO_COAT, SCENE_LAYERS, uvec2)
#define LAYER_2(DO) DO(sheen, Sheen, SheenParameters, NO_SHEEN, SCENE_LAYERS, uint)
#define LAYERS(DO) LAYER_1(DO) LAYER_2(DO)
#define LAYERS_FROM_BELOW(DO) LAYER_2(DO) LAYER_1(DO)

// Lobes in place of a share of the base.
#define BASE_LOBES(DO) DO(glass, Glass, GlassParameters, NO_GLASS, SCENE_GLASS, uint)

// Those that samples choose by a probability of their own.
#define LOBES(DO) LAYERS(DO) BASE_LOBES(DO)

// Diffuse transmission is a part of the diffuse lobe, and is chosen with it.
#define DIFFUSE_TRANSMISSION(DO) \
    DO(diffuse_transmission, DiffuseTransmission, DiffuseTransmissionParameters, NO_DIFFUSE_TRANSMISSION, \
        SCENE_DIFFUSE_TRANSMISSION, uint)
#define ALL_LOBES(DO) LOBES(DO) DIFFUSE_TRANSMISSION(DO)

#endif
