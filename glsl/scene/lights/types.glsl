// What all kinds of lights share. light_kinds.py lists the kinds and the functions that each defines.
#ifndef SCENE_LIGHTS_TYPES_GLSL
#define SCENE_LIGHTS_TYPES_GLSL

// Differs from Solari: 32 bits each for light and triangle, so that neither is limited to 65,535.
struct LightSample {
    uint light_index;
    uint part;  // for emissive meshes a triangle of the instance's ray mesh
    uint seed;
};

struct ResolvedLightSample {
    uint kind;
    uint data;            // what the kind stores for emission_cosine and light_sample_seen_from
    vec3 world_position;  // for kinds at infinity, the direction to the light
    vec3 world_normal;
    float ray_offset;
    vec3 radiance;
    float inverse_pdf;    // in area; for kinds at infinity, in solid angle
};

// What a ray sees of a light at infinity, or of one that it passes.
struct LightHit {
    vec3 radiance;
    float inverse_pdf;  // in solid angle, once the light is chosen; 0: the ray doesn't meet the light
    uint part;          // the part of the light that the ray meets
    vec2 u;             // the random numbers for which light samples of the part have the ray's direction
    float t;            // where the ray meets it; INFINITY for lights at infinity
};

const LightHit NO_LIGHT_HIT = LightHit(vec3(0.0), 0.0, 0u, vec2(0.0), INFINITY);

#endif
