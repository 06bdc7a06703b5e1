// The reservoirs of indirect diffuse light, one per pixel.
#ifndef PASSES_SOLARI019_RESTIR_GI_BINDINGS_GLSL
#define PASSES_SOLARI019_RESTIR_GI_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// The normal of a sample point on a mirror. Other pixels see something else in the mirror, so that such a sample is
// never reused by them.
const vec3 SEEN_IN_MIRROR = vec3(0.0);

// A point of another surface, and the light that it reflects to the pixel. GPUs access it by 16 bytes at once.
struct GiReservoir {
    vec3 sample_point_world_position;  // moved off its surface, so that rays can end there
    // The point's cell in the world cache, or NO_INDEX. The frame that stored the reservoir has read the cell, so that
    // the cell is still alive when the next frame reads it.
    uint world_cache_cell;
    vec3 sample_point_world_normal;    // geometric, on the side that the pixel sees
    float confidence_weight;           // in frames; 0 for pixels without GI
    vec3 radiance;                     // of the point towards the pixel, without emission and before its passage
    float unbiased_contribution_weight;  // in solid angle at the pixel; 0 when no light was found
    vec3 reflectance;                  // of the point: radiance over irradiance
    uint transmittance;  // rgb9e5, from the point to the pixel that shades with it, of scenes with blended surfaces
};

layout(set = 1, scalar) buffer GiTemporalReservoirsBlock { GiReservoir at[]; } gi_temporal_reservoirs;
// Temporal reuse reads those of the previous frame, spatial reuse replaces them.
layout(set = 1, scalar) buffer GiReservoirsBlock { GiReservoir at[]; } gi_reservoirs;

#endif
