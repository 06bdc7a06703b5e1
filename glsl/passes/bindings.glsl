// Descriptor set 1: what changes from frame to frame, the settings, and what passes hand to each other. Filled by name.
#ifndef PASSES_BINDINGS_GLSL
#define PASSES_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/settings.glsl"
#include "scene/camera.glsl"

layout(set = 1, binding = 0, scalar) uniform FrameBlock {
    uint index;             // counts the renderer's frames, and is never reset
    uint seed;
    uint has_history;       // 0 in the first frame and after a reset
    float exposure;
    float lighting_change;  // share of the lights' power that appeared, disappeared or moved in recent frames
} this_frame;

// ---- G-buffer: passes/gbuffer/gbuffer.glsl packs and unpacks ----------------------------------------

// base colour (gamma 2.2) and perceptual roughness 4x8 | emissive * exposure rgb9e5 | reflectance 8, metallic 8, the base
// colour's next 5 + 6 + 5 bits | shading normal octahedral 24, flags 8
layout(set = 1, binding = 20, rgba32ui) uniform uimage2D gbuffer;
layout(set = 1, binding = 21, rgba32ui) uniform uimage2D previous_gbuffer;
// geometric normal octahedral 2x16, facing the camera | instance index, NO_INDEX: nothing
layout(set = 1, binding = 22, rg32ui) uniform uimage2D gbuffer_surface;
layout(set = 1, binding = 23, rg32ui) uniform uimage2D previous_gbuffer_surface;
layout(set = 1, binding = 24, r32f) uniform image2D depth;           // near / distance along the view axis; 0: nothing
layout(set = 1, binding = 25, r32f) uniform image2D previous_depth;
layout(set = 1, binding = 26, rg16f) uniform image2D motion_vectors;  // uv of the last frame minus uv, without jitter

// Where instances were in the last frame. Solari's G-buffer knows it too; kept here so that every renderer of a scene has its own.
struct PreviousInstance {
    mat4x3 world_from_object;
    uint id;  // Instance.id then: another one means that the row is another instance's now
};
layout(set = 1, binding = 27, scalar) buffer PreviousInstancesBlock { PreviousInstance at[]; } previous_instances;

// ---- lights -----------------------------------------------------------------------------------------

// Index in light_sources of this frame of each light of the last one, NO_INDEX: gone; and the other way round.
layout(set = 1, binding = 30, scalar) readonly buffer LightTranslationBlock { uint at[]; } light_translation;
layout(set = 1, binding = 31, scalar) readonly buffer PreviousLightBlock { uint at[]; } previous_light;

// ---- what the passes leave for a pixel: radiance towards the camera, linear, before exposure ---------

layout(set = 1, binding = 90, scalar) buffer DiDiffuseBlock { vec3 at[]; } di_diffuse;
layout(set = 1, binding = 91, scalar) buffer DiSpecularBlock { vec3 at[]; } di_specular;
layout(set = 1, binding = 92, scalar) buffer GiDiffuseBlock { vec3 at[]; } gi_diffuse;
layout(set = 1, binding = 93, scalar) buffer SpecularGiBlock { vec3 at[]; } specular_gi;
layout(set = 1, binding = 94, scalar) buffer EmissionBlock { vec3 at[]; } emission;
layout(set = 1, binding = 95, scalar) buffer DiffuseRadianceBlock { vec3 at[]; } diffuse_radiance;    // di + gi
layout(set = 1, binding = 96, scalar) buffer SpecularRadianceBlock { vec3 at[]; } specular_radiance;  // di + specular gi
layout(set = 1, binding = 97, scalar) buffer RadianceBlock { vec3 at[]; } radiance;                   // all of it

// Rays of passes that have the specialization constant ray_counter, which is their row: passes/ray_count.glsl.
layout(set = 1, binding = 99, scalar) buffer RayCountsBlock { uint at[]; } ray_counts;

#endif
