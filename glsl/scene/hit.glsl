// Where a ray hit the scene: a point on a triangle of an instance. scene/trace.glsl finds hits, scene/surface.glsl
// resolves them.
#ifndef SCENE_HIT_GLSL
#define SCENE_HIT_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"

struct Hit {
    float t;            // in lengths of the ray's direction; infinite when nothing was hit
    uint instance;      // NO_INDEX when nothing was hit
    uint triangle;      // of the instance's ray mesh
    vec2 barycentrics;  // weights of the second and third vertex
    bool front_face;    // whether the ray hit the side whose vertices run counter-clockwise in object space
};

const Hit NO_HIT = Hit(INFINITY, NO_INDEX, 0u, vec2(0.0), false);

#endif
