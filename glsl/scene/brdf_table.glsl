// The table of the directional albedo of GGX, which passes/brdf_table computes.
#ifndef SCENE_BRDF_TABLE_GLSL
#define SCENE_BRDF_TABLE_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "common/math.glsl"

// The two that are read most are images, which a software device compiles in less than half the time of buffers.
layout(set = 0, rg32f) uniform image2D brdf_table;
layout(set = 0, r32f) uniform image2D sheen_table;
layout(set = 0, scalar) buffer BrdfAveragesBlock { vec3 at[]; } brdf_averages;
layout(set = 0, scalar) buffer GlassTableBlock { vec2 at[]; } glass_table;
layout(set = 0, scalar) buffer AnisotropyTableBlock { float at[]; } anisotropy_table;

// Rows: perceptual roughness from 0 to 1. Columns: the square root of the cosine to the normal from 0 to 1, because the
// albedo of smooth surfaces changes fastest at grazing angles. The host reads the size from here.
layout(constant_id = BRDF_TABLE_SIZE_id) const uint BRDF_TABLE_SIZE = 64u;

// A and B for a mirror, which is row 0: F0 A + B is Fresnel itself.
vec2 mirror_albedo(float NdotV) {
    float x = saturate(1.0 - NdotV);
    float fresnel = square(square(x)) * x;
    return vec2(1.0 - fresnel, fresnel);
}

struct TableCell {
    ivec2 at;   // the texel of its corner with the smallest row and column
    vec2 part;  // where a point lies in it, from 0 to 1
};

TableCell table_cell(float NdotV, float perceptual_roughness) {
    uint last = BRDF_TABLE_SIZE - 1u;
    vec2 position = vec2(sqrt(saturate(NdotV)), saturate(perceptual_roughness)) * float(last);
    uvec2 cell = min(uvec2(position), uvec2(last - 1u));
    return TableCell(ivec2(cell), position - vec2(cell));
}

// A and B of the single-scattering albedo F0 A + B.
vec2 lookup_brdf_table(float NdotV, float perceptual_roughness) {
    TableCell cell = table_cell(NdotV, perceptual_roughness);
    ivec2 at = cell.at;
    vec2 smoother = mix(imageLoad(brdf_table, at).xy, imageLoad(brdf_table, at + ivec2(1, 0)).xy, cell.part.x);
    vec2 rougher = mix(imageLoad(brdf_table, at + ivec2(0, 1)).xy, imageLoad(brdf_table, at + 1).xy, cell.part.x);
    return mix(smoother, rougher, cell.part.y);
}

vec2 albedo_terms(bool mirror, float perceptual_roughness, float cosine) {
    return mirror ? mirror_albedo(cosine) : lookup_brdf_table(cosine, perceptual_roughness);
}

// The directional albedo of GGX with multiple scattering, from the single-scattering albedo F0 A + B. Fdez-Aguero, "A
// Multiple-Scattering Microfacet Model for Real-Time Image-based Lighting" (JCGT 2019).
vec3 specular_albedo(vec3 f0, vec2 ab) {
    return min((f0 * ab.x + ab.y) * (1.0 + f0 * (1.0 / (ab.x + ab.y) - 1.0)), 1.0);  // not above 1 by rounding
}

// The directional albedo of white sheen (scene/lobes/sheen.glsl), in the same rows and columns.
float lookup_sheen_table(float NdotV, float perceptual_roughness) {
    TableCell cell = table_cell(NdotV, perceptual_roughness);
    ivec2 at = cell.at;
    float smoother = mix(imageLoad(sheen_table, at).x, imageLoad(sheen_table, at + ivec2(1, 0)).x, cell.part.x);
    float rougher = mix(imageLoad(sheen_table, at + ivec2(0, 1)).x, imageLoad(sheen_table, at + 1).x, cell.part.x);
    return mix(smoother, rougher, cell.part.y);
}

layout(constant_id = GLASS_TABLE_SIZE_id) const uint GLASS_TABLE_SIZE = 16u;  // rows and columns of a slice
// Slices go from an eta of 1/3 to 3, evenly in the signed square root of (eta - 1) / (eta + 1), because the albedo
// changes fastest near 1. There is a slice at 1, as the number is odd.
layout(constant_id = GLASS_TABLE_SLICES_id) const uint GLASS_TABLE_SLICES = 33u;
const float LARGEST_ETA_RATIO = 0.5;

// The albedo of single scattering of white glass (scene/lobes/glass.glsl) that is the boundary of a solid: x without
// reflections but total internal ones, y with those of its index of refraction. It is linear in between.
vec2 lookup_glass_table(float eta, float NdotV, float perceptual_roughness) {
    uint last = GLASS_TABLE_SIZE - 1u;
    vec3 position = vec3(sqrt(saturate(NdotV)), saturate(perceptual_roughness), 0.0) * float(last);
    float ratio = (eta - 1.0) / (eta + 1.0) / LARGEST_ETA_RATIO;
    position.z = saturate(0.5 * sign(ratio) * sqrt(abs(ratio)) + 0.5) * float(GLASS_TABLE_SLICES - 1u);
    uvec3 cell = min(uvec3(position), uvec3(last - 1u, last - 1u, GLASS_TABLE_SLICES - 2u));
    vec3 part = position - vec3(cell);
    vec2 albedo = vec2(0.0);
    for (uint corner = 0u; corner < 8u; corner++) {
        uvec3 to = uvec3(corner, corner >> 1u, corner >> 2u) & 1u;
        vec3 share = mix(1.0 - part, part, vec3(to));
        uvec3 at = cell + to;
        albedo += share.x * share.y * share.z
            * glass_table.at[(at.z * GLASS_TABLE_SIZE + at.y) * GLASS_TABLE_SIZE + at.x];
    }
    return albedo;
}

// Columns: the square root of the cosine to the normal; rows: the cosine of the turn from the direction of anisotropy;
// then perceptual roughness and the strength of anisotropy. All go from 0 to 1.
layout(constant_id = ANISOTROPY_TABLE_SIZE_id) const uint ANISOTROPY_TABLE_SIZE = 11u;

// The albedo of single scattering of a white anisotropic metal towards w, whose x is along the direction of anisotropy.
float lookup_anisotropy_table(vec3 w, float perceptual_roughness, float strength) {
    uint last = ANISOTROPY_TABLE_SIZE - 1u;
    float turn = abs(w.x) / max(length(w.xy), 1e-30);
    vec4 position = clamp(vec4(sqrt(max(w.z, 0.0)), turn, perceptual_roughness, strength), 0.0, 1.0) * float(last);
    uvec4 cell = min(uvec4(position), uvec4(last - 1u));
    vec4 part = position - vec4(cell);
    float albedo = 0.0;
    for (uint corner = 0u; corner < 16u; corner++) {
        uvec4 to = uvec4(corner, corner >> 1u, corner >> 2u, corner >> 3u) & 1u;
        vec4 share = mix(1.0 - part, part, vec4(to));
        uvec4 at = cell + to;
        uint row = (at.w * ANISOTROPY_TABLE_SIZE + at.z) * ANISOTROPY_TABLE_SIZE + at.y;
        albedo += share.x * share.y * share.z * share.w * anisotropy_table.at[row * ANISOTROPY_TABLE_SIZE + at.x];
    }
    return albedo;
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
