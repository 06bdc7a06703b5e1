// What ReSTIR GI keeps for every pixel.
#ifndef PASSES_RESTIR_GI_BINDINGS_GLSL
#define PASSES_RESTIR_GI_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// The normal of a point that is a mirror's: what it shows to one pixel it shows to no other, so nothing is reconnected to it.
const vec3 SEEN_IN_MIRROR = vec3(0.0);

// A point of another surface and the light that it reflects to a pixel.
struct GiReservoir {
    vec3 sample_point_world_position;  // moved off its surface, so that rays may end there
    vec3 sample_point_world_normal;    // geometric, on the side that is seen
    vec3 radiance;                     // from there, emission not counted
    vec3 reflectance;                  // of which that is the irradiance's product
    float confidence_weight;           // frames that it stands for; 0: the pixel takes no part in GI
    float unbiased_contribution_weight;  // in solid angle at the pixel that holds it; 0: nothing was found
};

layout(set = 1, binding = 65, scalar) buffer GiTemporalReservoirsBlock { GiReservoir at[]; } gi_temporal_reservoirs;
layout(set = 1, binding = 66, scalar) buffer GiReservoirsBlock { GiReservoir at[]; } gi_reservoirs;
layout(set = 1, binding = 67, scalar) buffer PreviousGiReservoirsBlock { GiReservoir at[]; } previous_gi_reservoirs;

#endif
