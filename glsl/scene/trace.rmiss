// What the rays that scene/trace.glsl traces by a ray pipeline return when they hit nothing.
#version 460
#extension GL_EXT_ray_tracing : require
#include "generated/bound/constants.glsl"  // NO_INDEX, written by solari_vk/bound/constants.py
#include "scene/payload.glsl"

layout(location = 0) rayPayloadInEXT RayPayload ray_payload;

void main() {
    ray_payload.instance = NO_INDEX;
}
