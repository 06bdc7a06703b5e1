// What point lights and sphere lights share: how light falls off, as KHR_lights_punctual recommends.
#ifndef SCENE_LIGHTS_PUNCTUAL_GLSL
#define SCENE_LIGHTS_PUNCTUAL_GLSL

#include "common/math.glsl"

struct PunctualLight {
    vec3 position;
    float radius;         // 0 for points
    vec3 strength;        // intensity of a point, radiance of a sphere
    vec3 axis;            // of the cone
    float cone_scale;     // 0 for lights without a cone
    float cone_offset;
    float inverse_range;  // 0 for lights without a range
};

// The share of the light's strength that it sends to a place at a distance from its center in a direction.
float punctual_falloff(PunctualLight light, vec3 direction, float distance) {
    float cone = saturate(dot(light.axis, direction) * light.cone_scale + light.cone_offset);
    float window = saturate(1.0 - square(square(distance * light.inverse_range)));
    return square(cone) * window;
}

#endif
