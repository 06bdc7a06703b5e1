// Descriptor set 1: the uniforms of a frame and what passes write. Filled by name.
#ifndef PASSES_BINDINGS_GLSL
#define PASSES_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

const uint LIGHTS_BY_MIS = 0u;
const uint LIGHTS_BY_SAMPLING = 1u;  // next event estimation alone
const uint LIGHTS_BY_BRDF = 2u;      // only what rays meet by themselves

const uint PIXEL_FILTER_BOX = 0u;
const uint PIXEL_FILTER_GAUSSIAN = 1u;  // standard deviation = radius / 4
const uint PIXEL_FILTER_BLACKMAN_HARRIS = 2u;

layout(set = 1, binding = 0, scalar) uniform UniformsBlock {
    mat4x3 world_from_view;   // the camera looks along -z, y up
    vec2 tan_half_fov;        // horizontal, vertical
    float near;               // distance of the near plane
    uvec2 size;               // of the picture, in pixels
    vec2 jitter;              // moves the picture's samples, in pixels
    uint first_row;           // the dispatch covers rows from here
    uint row_count;
    uint seed;
    uint sample_index;        // samples that every pixel of these rows has already
    uint samples_per_dispatch;
    uint max_bounces;         // 0: only what emits
    uint light_strategy;
    uint pixel_filter;
    float filter_radius;      // in pixels, 0.5 for a box of one pixel

    // ---- of the realtime passes only: what changes from frame to frame
    mat4x3 view_from_world;
    mat4x3 previous_world_from_view;  // the frame before's
    mat4x3 previous_view_from_world;
    vec2 previous_tan_half_fov;
    float previous_near;
    vec2 previous_jitter;
    uint frame_index;         // since the renderer was made; never starts anew
    uint has_history;         // 0 in the first frame and after a reset
    float exposure;
    float lighting_change;    // share of the lights' power that came, went or moved of late
    uint debug_view;          // index into DEBUG_VIEWS of passes/debug_views.py; 0: the picture
    uint tonemap;

    // ---- and the fields of solari_vk/settings, by the same names and in the same units
    uint di;
    uint gi;
    uint specular;
    uint world_cache;
    float pure_metal;
    float similarity_plane_distance;
    float similarity_normal_cosine;
    uint permutation_sampling;
    uint spatial_tries;
    uint spatial_radius_halving;

    uint light_tile_encoding;
    uint light_sampling;

    float world_cache_cell_size;
    float world_cache_lod_distance;
    float world_cache_lod_sharpness;
    uint world_cache_lifetime;
    uint world_cache_lifetime_rule;
    uint world_cache_search_steps;
    uint world_cache_max_samples;
    uint world_cache_blend;
    float world_cache_change_exponent;
    float world_cache_change_smoothing;
    uint world_cache_relight;
    uint world_cache_candidates;
    float world_cache_ray_length;
    uint world_cache_update_cap;
    float world_cache_jitter;
    uint world_cache_leak_prevention;

    uint di_candidates;
    uint di_temporal;
    uint di_spatial;
    uint di_initial_visibility;
    uint di_target;
    uint di_order;
    uint di_merge;
    float di_confidence_cap;
    float di_spatial_radius;

    uint gi_temporal;
    uint gi_spatial;
    float gi_confidence_cap;
    float gi_spatial_radius;
    float gi_jacobian_limit;
    uint gi_skip_smooth_metals;
    uint gi_visibility;
    uint gi_refresh;

    uint specular_bounces;
    float specular_reuse_roughness;
    float specular_di_roughness;
    uint specular_termination;
    uint specular_mirror;
    uint primary_surface_replacement;
} uniforms;

// ---- choices of the settings -----------------------------------------------------------------------

const uint ENCODING_LOG2 = 0u;
const uint ENCODING_LINEAR = 1u;        // Solari 0.17
const uint LIGHTS_FROM_TILES = 0u;
const uint LIGHTS_RESOLVED = 1u;        // each candidate resolved where it is needed: before light tiles
const uint LIFETIME_MAX = 0u;
const uint LIFETIME_STORE = 1u;         // Solari 0.17: cells keep each other alive
const uint BLEND_ADAPTIVE = 0u;
const uint BLEND_FIXED = 1u;            // Solari 0.17
const uint LEAKS_PARTED = 0u;           // by what is seen of a cell
const uint LEAKS_FINEST = 1u;           // Solari 0.19: the smallest cells for short rays
const uint LEAKS_ALLOWED = 2u;
const uint TARGET_BRDF = 0u;
const uint TARGET_MATTE = 1u;           // as if all that is reflected were diffuse
const uint ORDER_0_18 = 0u;
const uint ORDER_0_17 = 1u;             // visibility of the spatial sample, fed forward
const uint MERGE_BALANCE = 0u;
const uint MERGE_CONSTANT = 1u;         // Solari 0.17
const uint GI_VISIBILITY_BOTH = 0u;
const uint GI_VISIBILITY_0_17 = 1u;     // of the spatial sample alone, and weights as if it were seen from everywhere
const uint TERMINATION_SPREAD = 0u;
const uint TERMINATION_ROUGHNESS = 1u;  // Solari 0.18
const uint MIRROR_BRDF = 0u;
const uint MIRROR_CLAMPED_GGX = 1u;     // Solari 0.18

// ---- the BRDF's directional albedo ------------------------------------------------------------------

layout(set = 1, binding = 1, scalar) buffer BrdfTableBlock { vec2 at[]; } brdf_table;
layout(set = 1, binding = 2, scalar) buffer BrdfAveragesBlock { vec3 at[]; } brdf_averages;

// ---- reference path tracer --------------------------------------------------------------------------

layout(set = 1, binding = 3, scalar) buffer RadianceMeanBlock { vec3 at[]; } radiance_mean;
// Of luminance over samples: sum of squared distances from the mean.
layout(set = 1, binding = 4, scalar) buffer LuminanceDeviationsBlock { float at[]; } luminance_deviations;
layout(set = 1, binding = 13, scalar) buffer RayCountBlock { uint at[]; } ray_count;  // traced for the pixel so far

layout(set = 1, binding = 5, scalar) buffer DepthBlock { float at[]; } aov_depth;  // along the view axis, inf: nothing
layout(set = 1, binding = 6, scalar) buffer PositionBlock { vec3 at[]; } aov_position;
layout(set = 1, binding = 7, scalar) buffer GeometricNormalBlock { vec3 at[]; } aov_geometric_normal;
layout(set = 1, binding = 8, scalar) buffer ShadingNormalBlock { vec3 at[]; } aov_shading_normal;
layout(set = 1, binding = 9, scalar) buffer AlbedoBlock { vec3 at[]; } aov_albedo;
layout(set = 1, binding = 10, scalar) buffer RoughnessMetallicBlock { vec2 at[]; } aov_roughness_metallic;
layout(set = 1, binding = 11, scalar) buffer EmissiveBlock { vec3 at[]; } aov_emissive;
layout(set = 1, binding = 12, scalar) buffer InstanceIdBlock { uint at[]; } aov_instance_id;  // NO_INDEX: nothing

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
layout(set = 1, binding = 98, rgba8) uniform image2D display;

// Rays of passes that have the specialization constant ray_counter, which is their row: passes/ray_count.glsl.
layout(set = 1, binding = 99, scalar) buffer RayCountsBlock { uint at[]; } ray_counts;

#endif
