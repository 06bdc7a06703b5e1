// Declares the records of descriptor set 0 and computes nothing: the binder reads the layout of the records from it.
#version 460
#include "generated/scene/light_kinds.glsl"
#include "scene/bindings.glsl"

// Shaders reach vertices through buffer references, which have no name; this block gives their layout one.
layout(set = 0, binding = 14, scalar) readonly buffer VertexAttributesBlock {
    VertexAttributes at[];
} vertex_attributes;

void main() {}
