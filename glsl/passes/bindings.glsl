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
} uniforms;

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

#endif
