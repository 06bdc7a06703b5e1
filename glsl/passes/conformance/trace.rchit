// The answer of a ray that hits a triangle or a box.
#version 460
#extension GL_EXT_ray_tracing : require
#include "passes/conformance/trace_rays.glsl"

layout(location = 0) rayPayloadInEXT Hit hit;

void main() {
    hit = Hit(gl_HitTEXT, uint(gl_InstanceCustomIndexEXT), uint(gl_InstanceID), uint(gl_GeometryIndexEXT),
              uint(gl_PrimitiveID));
}
