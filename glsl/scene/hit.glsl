// Where a ray hit the scene: a point on a triangle of an instance. scene/trace.glsl finds hits, scene/surface.glsl
// resolves them.
#ifndef SCENE_HIT_GLSL
#define SCENE_HIT_GLSL

struct Hit {
    float t;            // in lengths of the ray's direction; infinite when nothing was hit
    uint instance;      // NO_INDEX when nothing was hit
    uint triangle;      // of the instance's ray mesh
    vec2 barycentrics;  // weights of the second and third vertex
    bool front_face;    // whether the ray hit the side whose vertices run counter-clockwise in object space
};

#endif
