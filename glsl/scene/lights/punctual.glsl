// What point lights and sphere lights share: how light falls off, as KHR_lights_punctual recommends.
#ifndef SCENE_LIGHTS_PUNCTUAL_GLSL
#define SCENE_LIGHTS_PUNCTUAL_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"

// A photometric (IES) profile: intensities over the largest, by vertical angles from 0 to 180 degrees and horizontal
// ones below 360. solari_vk.LightProfile.
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Profile { float intensities[]; };

const uint PROFILE_ROWS = 361u;

struct PunctualLight {
    vec3 position;
    float radius;         // 0 for points
    vec3 strength;        // intensity of a point, radiance of a sphere
    vec3 axis;            // of the cone
    float cone_scale;     // 0 for lights without a cone
    float cone_offset;
    float inverse_range;  // 0 for lights without a range
    Profile profile;      // null for lights without a profile
    uint profile_columns;
    mat3 profile_axes;    // the directions of horizontal angles 0 and 90 degrees, and of vertical angle 0
};

// The profile's relative intensity in a direction, by bilinear interpolation.
float profile_intensity(PunctualLight light, vec3 direction) {
    vec3 local = direction * light.profile_axes;
    float row = acos(clamp(local.z, -1.0, 1.0)) / PI * float(PROFILE_ROWS - 1u);
    float column = (local.x == 0.0 && local.y == 0.0 ? 0.0 : fract(atan(local.y, local.x) / (2.0 * PI)))
        * float(light.profile_columns);
    uint upper = min(uint(row), PROFILE_ROWS - 2u), left = min(uint(column), light.profile_columns - 1u);
    uint right = left + 1u == light.profile_columns ? 0u : left + 1u;
    uint at = upper * light.profile_columns, below = at + light.profile_columns;
    vec2 between_columns = mix(
        vec2(light.profile.intensities[at + left], light.profile.intensities[below + left]),
        vec2(light.profile.intensities[at + right], light.profile.intensities[below + right]), column - float(left)
    );
    return mix(between_columns.x, between_columns.y, row - float(upper));
}

// The factor of the light's strength for a receiver at a distance from its center in a direction: spot cone, range and
// profile. The inverse square of the distance is left out.
float punctual_falloff(PunctualLight light, vec3 direction, float distance) {
    float cone = saturate(dot(light.axis, direction) * light.cone_scale + light.cone_offset);
    float window = saturate(1.0 - square(square(distance * light.inverse_range)));
    float share = square(cone) * window;
    if (SCENE_PROFILES && uvec2(light.profile) != uvec2(0u)) { share *= profile_intensity(light, direction); }
    return share;
}

#endif
