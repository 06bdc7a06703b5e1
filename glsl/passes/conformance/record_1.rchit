// Number 1 of the hit shaders whose records are asked for.
#version 460
#extension GL_EXT_ray_tracing : require

layout(location = 0) rayPayloadInEXT uint number;

void main() {
    number = 1u;
}
