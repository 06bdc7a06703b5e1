// The clearcoat: a layer of GGX over all other lobes.
#ifndef SCENE_LOBES_COAT_GLSL
#define SCENE_LOBES_COAT_GLSL

#include "common/math.glsl"
#include "scene/brdf_table.glsl"
#include "scene/material_lobes.glsl"
#include "scene/microfacet.glsl"

const float COAT_F0 = 0.04;  // of an index of refraction of 1.5

struct Coat {
    float weight;
    float roughness;
    float perceptual_roughness;
    mat3 frame;  // its z axis is the coat's normal
    vec3 wo;     // in that frame
    float pdf_per_d;
    float multiscatter;
    bool inside;  // wo is below it
};

bool is_mirror_coat(Coat coat) { return coat.roughness <= MIRROR_ROUGHNESS; }

vec2 coat_albedo_terms(float perceptual_roughness, float cosine) {
    return albedo_terms(square(perceptual_roughness) <= MIRROR_ROUGHNESS, perceptual_roughness, cosine);
}

// The share of uniform incoming light that the coat reflects.
float coat_albedo(float weight, float perceptual_roughness, float cosine) {
    return weight * specular_albedo(vec3(COAT_F0), coat_albedo_terms(perceptual_roughness, cosine)).x;
}

Coat prepare_coat(MaterialLobes lobes, vec3 wo) {
    Coat coat;
    coat.frame = orthonormalize(lobes.coat_normal);
    coat.wo = wo * coat.frame;
    coat.inside = lobes.inside;
    coat.weight = lobes.inside || !(coat.wo.z > 0.0) ? 0.0 : lobes.coat;
    coat.perceptual_roughness = lobes.coat_roughness;
    coat.roughness = square(lobes.coat_roughness);
    vec2 ab = coat_albedo_terms(lobes.coat_roughness, coat.wo.z);
    coat.multiscatter = 1.0 / (ab.x + ab.y) - 1.0;
    coat.pdf_per_d = 0.0;
    if (coat.weight > 0.0 && !is_mirror_coat(coat)) {
        coat.pdf_per_d = ggx_vndf_pdf_per_d(coat.wo, coat.roughness);
    }
    return coat;
}

// The largest share of light that the coat keeps from what lies below it, for light from wi to wo. Directions within a
// volume don't pass it.
float coat_cover(Coat coat, vec3 wo, vec3 wi) {
    bool wi_inside = wi.z < 0.0 != coat.inside;
    float roughness = coat.perceptual_roughness;
    float seen = coat.inside ? 0.0 : coat_albedo(coat.weight, roughness, abs(coat.wo.z));
    float lit = wi_inside ? 0.0 : coat_albedo(coat.weight, roughness, abs(dot(wi, coat.frame[2])));
    return max(seen, lit);
}

float coat_fresnel(Coat coat, float cosine) {
    return coat.weight * fresnel(vec3(COAT_F0), cosine).x * (1.0 + COAT_F0 * coat.multiscatter);
}

float evaluate_coat(Coat coat, vec3 wi) {
    vec3 coat_wi = wi * coat.frame;
    if (!(coat.weight > 0.0) || is_mirror_coat(coat) || !(coat_wi.z > 0.0)) { return 0.0; }
    vec3 half_vector = normalize(coat.wo + coat_wi);
    float V = V_SmithGGXCorrelated(coat.roughness, coat.wo.z, coat_wi.z);
    return coat_fresnel(coat, dot(coat_wi, half_vector)) * D_GGX(coat.roughness, half_vector) * V * coat_wi.z;
}

float coat_pdf(Coat coat, vec3 wi) {
    vec3 coat_wi = wi * coat.frame;
    if (!(coat.weight > 0.0) || is_mirror_coat(coat) || !(coat_wi.z > 0.0)) { return 0.0; }
    return coat.pdf_per_d * D_GGX(coat.roughness, normalize(coat.wo + coat_wi));
}

vec3 sample_coat(Coat coat, vec2 u) {
    vec3 wo = coat.wo;
    vec3 wi = is_mirror_coat(coat) ? vec3(-wo.xy, wo.z) : sample_ggx_vndf(wo, coat.roughness, u);
    return wi.z > 0.0 ? coat.frame * wi : vec3(0.0);
}

#endif
