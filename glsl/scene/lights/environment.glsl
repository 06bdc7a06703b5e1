// Environment maps at infinity, by longitude and latitude. Light samples choose a texel by its power and a point of the
// texel uniformly; radiance is interpolated between the texels' centers, for light samples and for rays that hit the
// light alike, so that both have the same mean.
#ifndef SCENE_LIGHTS_ENVIRONMENT_GLSL
#define SCENE_LIGHTS_ENVIRONMENT_GLSL

#include "common/math.glsl"
#include "common/packing.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/portal_sampling.glsl"
#include "scene/lights/types.glsl"

struct Environment {
    Words texels;  // rgb9e5
    AliasTable choices;  // of texels, by power
    uvec2 size;       // in texels: longitude, latitude; the first row is up
    float scale;      // radiance of a texel that holds 1, before the intensity
    float intensity;
    mat3 world_from_map;
};

layout(set = 0, scalar) readonly buffer EnvironmentsBlock {
    Environment at[];
} environments;

const float MIN_POLAR_SINE = 1e-6;  // so that the pdf is finite at the poles

vec3 load_texel(Environment map, ivec2 texel) {
    uint column = texel.x < 0 ? map.size.x - 1u : uint(texel.x) == map.size.x ? 0u : uint(texel.x);
    uint row = uint(clamp(texel.y, 0, int(map.size.y) - 1));
    return unpack_rgb9e5(map.texels.at[row * map.size.x + column]);
}

// `position` is in texels, with centers at + 0.5.
vec3 environment_radiance(Environment map, vec2 position) {
    vec2 first = floor(position - 0.5), share = position - 0.5 - first;
    ivec2 texel = ivec2(first);
    vec3 upper = mix(load_texel(map, texel), load_texel(map, texel + ivec2(1, 0)), share.x);
    vec3 lower = mix(load_texel(map, texel + ivec2(0, 1)), load_texel(map, texel + ivec2(1, 1)), share.x);
    return map.intensity * map.scale * mix(upper, lower, share.y);
}

// The solid angle of a texel, as if it were all at one polar angle.
float texel_solid_angle(Environment map, float polar_sine) {
    return 2.0 * PI * PI / (float(map.size.x) * float(map.size.y)) * max(polar_sine, MIN_POLAR_SINE);
}

ResolvedLightSample resolve_environment(uint index, uint part, vec2 u, float inverse_probability) {
    Environment map = environments.at[index];
    vec2 position = vec2(part % map.size.x, part / map.size.x) + u;
    float longitude = 2.0 * PI * (position.x / float(map.size.x) - 0.5);
    float polar_angle = PI * position.y / float(map.size.y);
    float polar_sine = sin(polar_angle);
    vec3 direction = map.world_from_map
        * vec3(polar_sine * cos(longitude), cos(polar_angle), polar_sine * sin(longitude));
    return ResolvedLightSample(
        LIGHT_ENVIRONMENT, index, direction, -direction, 0.0, environment_radiance(map, position),
        inverse_probability * texel_solid_angle(map, polar_sine)
    );
}

float emission_cosine_environment(uint index, float cosine) { return 1.0; }

uint debug_color_id_environment(uint index) { return ~index - 0x10000u; }

LightHit evaluate_environment(uint index, vec3 direction) {
    Environment map = environments.at[index];
    vec3 local = direction * map.world_from_map;
    float polar_sine = length(local.xz);
    vec2 share = vec2(atan(local.z, local.x) / (2.0 * PI) + 0.5, atan(polar_sine, local.y) / PI);
    vec2 position = share * vec2(map.size);
    uvec2 texel = min(uvec2(max(position, 0.0)), map.size - 1u);
    uint part = texel.y * map.size.x + texel.x;
    float probability = map.choices.at[part].probability;
    if (!(probability > 0.0)) { return NO_LIGHT_HIT; }  // black, with its neighbors
    return LightHit(
        environment_radiance(map, position), texel_solid_angle(map, polar_sine) / probability, part,
        clamp(position - vec2(texel), 0.0, 1.0), INFINITY
    );
}

// Weights the radiance by the balance heuristic against samples of portals: scene/lights/portal.glsl.
ResolvedLightSample sample_for_receiver_environment(ResolvedLightSample light_sample, vec3 receiver) {
    if (!has_portals()) { return light_sample; }
    vec3 direction = light_sample.world_position;
    LightHit light_hit = evaluate_environment(light_sample.data, direction);
    if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { return light_sample; }
    LightSource light = light_sources.at[scene_info.first_environment + light_sample.data];
    float map_pdf = light_probability_by_power(light) / light_hit.inverse_solid_angle_pdf;
    light_sample.radiance *= map_pdf > 0.0 ? map_pdf / (map_pdf + sum_portal_pdfs(receiver, direction, NO_INDEX)) : 1.0;
    return light_sample;
}

#endif
