// Descriptor set 1: the frame's values, the settings, and what passes pass on to each other. Filled by name.
#ifndef PASSES_BINDINGS_GLSL
#define PASSES_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/settings.glsl"  // X_settings: blocks by solari_vk/settings/shaders.py; settings.py explains each
#include "passes/views.glsl"
#include "scene/camera_block.glsl"

// this_frame is the view's; all_views has what views share, for passes that have no pixel.
#ifdef MANY_VIEWS
layout(set = 1, scalar) uniform FrameBlock { FrameValues all_views; };
#define this_frame views.at[view_index].frame
#else
layout(set = 1, scalar) uniform FrameBlock { FrameValues this_frame; };
#define all_views this_frame
#endif

// ---- G-buffer: passes/gbuffer/gbuffer.glsl packs and unpacks ----------------------------------------

// base color (gamma 2.2) and perceptual roughness 4x8 | emissive * exposure rgb9e5 | reflectance 8, metallic 8, the
// next 5 + 6 + 5 bits of the base color | shading normal octahedral 24, flags 8
layout(set = 1, rgba32ui) uniform uimage2D gbuffer;
layout(set = 1, rgba32ui) uniform uimage2D previous_gbuffer;
// geometric normal octahedral 2x16, facing the camera | instance index, NO_INDEX without a surface
layout(set = 1, rg32ui) uniform uimage2D gbuffer_surface;
layout(set = 1, rg32ui) uniform uimage2D previous_gbuffer_surface;
// GBufferSurface.ray_offset and lift, as the upper halves of floats
layout(set = 1, r32ui) uniform uimage2D gbuffer_offsets;
layout(set = 1, r32f) uniform image2D depth;  // near / distance along the view axis; 0 without a surface
layout(set = 1, r32f) uniform image2D previous_depth;
layout(set = 1, rg16f) uniform image2D motion_vectors;  // previous frame's uv minus uv, without jitter

// The transform of an instance in the previous frame. Each renderer of a scene has its own copy.
struct PreviousInstance {
    mat4x3 world_from_object;
    uint id;  // Instance.id in that frame; when it differs now, the row belongs to another instance
    uint material;
    float opacity;  // of the material: opacity_of
};
layout(set = 1, scalar) buffer PreviousInstancesBlock { PreviousInstance at[]; } previous_instances;
// After a frame, when previous_instances has its own: those of the frame before.
layout(set = 1, scalar) buffer OlderInstancesBlock { PreviousInstance at[]; } older_instances;

// ---- lights -----------------------------------------------------------------------------------------

// For each light of the previous frame its index in this frame's light_sources, or NO_INDEX; and for each light of this
// frame its index in the previous one.
layout(set = 1, scalar) readonly buffer LightTranslationBlock { uint at[]; } light_translation;
layout(set = 1, scalar) readonly buffer PreviousLightBlock { uint at[]; } previous_light;

// ---- results of the passes for each pixel: radiance towards the camera, linear, before exposure ------

layout(set = 1, scalar) buffer DiDiffuseBlock { vec3 at[]; } di_diffuse;
layout(set = 1, scalar) buffer DiSpecularBlock { vec3 at[]; } di_specular;
layout(set = 1, scalar) buffer GiDiffuseBlock { vec3 at[]; } gi_diffuse;
layout(set = 1, scalar) buffer SpecularGiBlock { vec3 at[]; } specular_gi;
layout(set = 1, scalar) buffer SpecularGiDistancesBlock { float at[]; } specular_gi_distances;  // as paths_specular.w
layout(set = 1, scalar) buffer EmissionBlock { vec3 at[]; } emission;
layout(set = 1, scalar) buffer DiffuseRadianceBlock { vec3 at[]; } diffuse_radiance;
layout(set = 1, scalar) buffer SpecularRadianceBlock { vec3 at[]; } specular_radiance;
// In pixels: from where the previous frame showed what a smooth surface reflects, as two halves. NO_REFLECTION_MOTION
// or more where it is unknown.
layout(set = 1, scalar) buffer ReflectionMotionBlock { uint at[]; } reflection_motion;
const float NO_REFLECTION_MOTION = 16384.0;
// emission + diffuse_radiance + specular_radiance
layout(set = 1, scalar) buffer SampleRadianceBlock { vec3 at[]; } sample_radiance;
// The picture, of camera.picture_size: passes/taa/resolve.comp makes it from sample_radiance.
layout(set = 1, scalar) buffer RadianceBlock { vec3 at[]; } radiance;

// Numbers of rays by pass; passes/ray_count.glsl.
layout(set = 1, scalar) buffer RayCountsBlock { uint at[]; } ray_counts;

#endif
