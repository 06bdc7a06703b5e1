// Number 3 of the miss shaders whose records are asked for.
#version 460
#extension GL_EXT_ray_tracing : require

layout(location = 0) rayPayloadInEXT uint number;

void main() {
    number = 13u;
}
