// Declares the records of descriptor set 0 and does nothing: the binder reads their layout from it.
#version 460
#include "generated/scene/light_kinds.glsl"
#include "scene/bindings.glsl"

// Vertices are reached through buffer references; as a block, their layout can be read by name.
layout(set = 0, binding = 14, scalar) readonly buffer VertexAttributesBlock { VertexAttributes at[]; } vertex_attributes;

void main() {}
