// What the hit and miss shaders of a ray pipeline return to scene/trace.glsl.
#ifndef SCENE_PAYLOAD_GLSL
#define SCENE_PAYLOAD_GLSL

struct RayPayload {
    uint instance;  // 2 * index + 1 for a front face, 2 * index for a back face; NO_INDEX when nothing was hit
    uint triangle;
    float t;
    vec2 barycentrics;
};

#endif
