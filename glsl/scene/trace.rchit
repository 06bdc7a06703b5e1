// The closest hit of each ray that scene/trace.glsl traces by a ray pipeline.
#version 460
#extension GL_EXT_ray_tracing : require
#include "scene/payload.glsl"

layout(location = 0) rayPayloadInEXT RayPayload ray_payload;
hitAttributeEXT vec2 barycentrics;

void main() {
    uint front_face = gl_HitKindEXT == gl_HitKindFrontFacingTriangleEXT ? 1u : 0u;
    ray_payload = RayPayload(
        uint(gl_InstanceCustomIndexEXT) << 1u | front_face, uint(gl_PrimitiveID), gl_HitTEXT, barycentrics
    );
}
