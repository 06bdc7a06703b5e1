// What all kinds of lights share. solari_vk/bound/lights/light_kinds.py lists the kinds and says what the functions do
// that each of them defines.
#ifndef SCENE_LIGHTS_TYPES_GLSL
#define SCENE_LIGHTS_TYPES_GLSL

#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require

#include "common/math.glsl"  // INFINITY

// A buffer that belongs to one light or texture: texels, or the summed-area tables of a portal's maps. One type for
// all, since shader optimizers confuse types that are alike.
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Words { uint at[]; };

// A point of a light, by the seed of its random numbers. Differs from Solari: 32 bits each for light and triangle, so
// that neither is limited to 65,535.
struct LightSample {
    uint light_index;
    uint part;  // the triangle of an emissive mesh or the texel of an environment; 0 for other lights
    uint seed;
};

// The point of a LightSample in world space. What some kinds of lights send depends on the receiver: its sample is what
// light_sample_for_receiver returns, which calls the kind's sample_for_receiver_NAME.
struct ResolvedLightSample {
    uint kind;
    uint data;            // what the kind stores for emission_cosine and light_sample_for_receiver
    vec3 world_position;  // for kinds at infinity, the direction to the light
    vec3 world_normal;
    float ray_offset;
    vec3 radiance;
    float inverse_area_pdf;  // one over the pdf in area; for kinds at infinity, in solid angle
};

// What a ray finds of a light at infinity, or of one that it goes through, such as a sphere light.
struct LightHit {
    vec3 radiance;
    float inverse_solid_angle_pdf;  // one over the pdf of the direction, once the light is chosen; 0: no hit
    uint part;  // of the light that the ray hits
    vec2 u;     // the inverse of sampling: the random numbers for which a light sample has the ray's direction
    float t;    // of the hit; INFINITY for lights at infinity
};

const LightHit NO_LIGHT_HIT = LightHit(vec3(0.0), 0.0, 0u, vec2(0.0), INFINITY);

#endif
