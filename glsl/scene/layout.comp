// Declares the records of descriptor set 0 and computes nothing: the binder reads the layout of the records from it.
#version 460
#include "generated/bound/lights/light_kinds.glsl"
#include "scene/bindings.glsl"
#include "scene/posed.glsl"

// Shaders reach vertices through buffer references, which have no name; this block gives their layout one.
layout(set = 0, scalar) readonly buffer VertexAttributesBlock {
    VertexAttributes at[];
} vertex_attributes;

// The same for the records of scene/deform.comp.
layout(set = 1, scalar) readonly buffer PosedMeshesBlock { PosedMesh at[]; } posed_meshes;
layout(set = 1, scalar) readonly buffer JointsBlock { Joint at[]; } joints;
layout(set = 1, scalar) readonly buffer ActiveTargetsBlock { ActiveTarget at[]; } active_targets;
layout(set = 1, scalar) readonly buffer InfluencesBlock { Influence at[]; } influences;

void main() {}
