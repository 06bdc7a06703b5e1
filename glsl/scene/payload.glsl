// What the hit and miss shaders of a ray pipeline return to scene/trace.glsl.
#ifndef SCENE_PAYLOAD_GLSL
#define SCENE_PAYLOAD_GLSL

#include "scene/alpha.glsl"

// A ray that skips the closest-hit shader has no hit but a RayTransmittance in the same memory: the edges that it has
// passed in `instance`, its probability in `triangle`, its weight in `t` and `barycentrics`. For other rays `instance`
// and `triangle` are the alpha seed until there is a hit.
struct RayPayload {
    uint instance;  // 2 * index + 1 for a front face, 2 * index for a back face; NO_INDEX when nothing was hit
    uint triangle;
    float t;
    vec2 barycentrics;
};

void write_ray_transmittance(inout RayPayload payload, RayTransmittance through) {
    payload.triangle = floatBitsToUint(through.probability);
    payload.t = through.weight.x;
    payload.barycentrics = through.weight.yz;
}

RayTransmittance read_ray_transmittance(RayPayload payload) {
    return RayTransmittance(vec3(payload.t, payload.barycentrics), uintBitsToFloat(payload.triangle));
}

#endif
