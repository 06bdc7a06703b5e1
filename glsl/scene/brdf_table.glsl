// The table of the directional albedo of GGX, which passes/brdf_table computes.
#ifndef SCENE_BRDF_TABLE_GLSL
#define SCENE_BRDF_TABLE_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "common/math.glsl"

layout(set = 0, binding = 10, scalar) buffer BrdfTableBlock { vec2 at[]; } brdf_table;
layout(set = 0, binding = 11, scalar) buffer BrdfAveragesBlock { vec3 at[]; } brdf_averages;

// Rows: perceptual roughness from 0 to 1. Columns: the square root of the cosine to the normal from 0 to 1, because the
// albedo of smooth surfaces changes fastest at grazing angles. The host reads the size from here.
layout(constant_id = 2) const uint BRDF_TABLE_SIZE = 64u;

// A and B for a mirror, which is row 0: F0 A + B is Fresnel itself.
vec2 mirror_albedo(float NdotV) {
    float x = saturate(1.0 - NdotV);
    float fresnel = square(square(x)) * x;
    return vec2(1.0 - fresnel, fresnel);
}

// A and B of the single-scattering albedo F0 A + B.
vec2 lookup_brdf_table(float NdotV, float perceptual_roughness) {
    uint last = BRDF_TABLE_SIZE - 1u;
    vec2 position = vec2(sqrt(saturate(NdotV)), saturate(perceptual_roughness)) * float(last);
    uvec2 cell = min(uvec2(position), uvec2(last - 1u));
    vec2 part = position - vec2(cell);
    uint first = cell.y * BRDF_TABLE_SIZE + cell.x;
    vec2 smoother = mix(brdf_table.at[first], brdf_table.at[first + 1u], part.x);
    vec2 rougher = mix(brdf_table.at[first + BRDF_TABLE_SIZE], brdf_table.at[first + BRDF_TABLE_SIZE + 1u], part.x);
    return mix(smoother, rougher, part.y);
}

// The cosine-weighted average of the multiple-scattering albedo is column 0 + F0 column 1 + F0^2 column 2.
mat3 lookup_brdf_averages(float perceptual_roughness) {
    uint last = BRDF_TABLE_SIZE - 1u;
    float position = saturate(perceptual_roughness) * float(last);
    uint row = min(uint(position), last - 1u);
    vec3 average = mix(brdf_averages.at[row], brdf_averages.at[row + 1u], position - float(row));
    return mat3(vec3(average.x), vec3(average.y), vec3(average.z));
}

#endif
