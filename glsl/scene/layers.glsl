// What lies over a surface: a clearcoat over sheen over all else, as glTF orders them. A layer takes from the light
// below what it reflects, seen from whichever direction it reflects more to. This is reciprocal and gains no energy:
// Kulla and Conty (2017), and KHR_materials_sheen.
#ifndef SCENE_LAYERS_GLSL
#define SCENE_LAYERS_GLSL

#include "common/math.glsl"
#include "scene/brdf_table.glsl"
#include "scene/material_lobes.glsl"
#include "scene/microfacet.glsl"
#include "scene/sheen.glsl"

const float COAT_F0 = 0.04;  // of an index of refraction of 1.5

// The layers of a material seen from one direction.
struct Layers {
    float coat;
    float coat_roughness;
    float coat_perceptual_roughness;
    mat3 coat_frame;  // its z axis is the coat's normal
    vec3 coat_wo;     // in that frame
    float coat_pdf_per_d;
    float coat_multiscatter;
    vec3 sheen_color;
    float sheen_roughness;  // perceptual
    bool inside;      // wo is below all layers
};

bool is_mirror_coat(Layers layers) { return layers.coat_roughness <= MIRROR_ROUGHNESS; }

vec2 coat_albedo_terms(float perceptual_roughness, float cosine) {
    return square(perceptual_roughness) <= MIRROR_ROUGHNESS
        ? mirror_albedo(cosine) : lookup_brdf_table(cosine, perceptual_roughness);
}

// The share of uniform incoming light that the coat reflects.
float coat_albedo(float coat, float perceptual_roughness, float cosine) {
    return coat * specular_albedo(vec3(COAT_F0), coat_albedo_terms(perceptual_roughness, cosine)).x;
}

// The same of white sheen.
float sheen_albedo(float perceptual_roughness, float cosine) {
    return min(lookup_sheen_table(cosine, perceptual_roughness), 1.0);
}

Layers prepare_layers(MaterialLobes lobes, vec3 wo) {
    Layers layers;
    layers.coat_frame = orthonormalize(lobes.coat_normal);
    layers.coat_wo = wo * layers.coat_frame;
    layers.inside = lobes.inside;
    layers.coat = lobes.inside || !(layers.coat_wo.z > 0.0) ? 0.0 : lobes.coat;
    layers.coat_perceptual_roughness = lobes.coat_roughness;
    layers.coat_roughness = square(lobes.coat_roughness);
    vec2 ab = coat_albedo_terms(lobes.coat_roughness, layers.coat_wo.z);
    layers.coat_multiscatter = 1.0 / (ab.x + ab.y) - 1.0;
    layers.coat_pdf_per_d = 0.0;
    if (layers.coat > 0.0 && !is_mirror_coat(layers)) {
        layers.coat_pdf_per_d = ggx_vndf_pdf_per_d(layers.coat_wo, layers.coat_roughness);
    }
    layers.sheen_color = lobes.sheen_color;
    layers.sheen_roughness = lobes.sheen_roughness;
    return layers;
}

// The largest share of light that a layer keeps from what lies below it, for light from wi to wo. Directions within a
// volume don't pass the layers.
float coat_cover(Layers layers, vec3 wo, vec3 wi) {
    bool wi_inside = wi.z < 0.0 != layers.inside;
    float roughness = layers.coat_perceptual_roughness;
    float seen = layers.inside ? 0.0 : coat_albedo(layers.coat, roughness, abs(layers.coat_wo.z));
    float lit = wi_inside ? 0.0 : coat_albedo(layers.coat, roughness, abs(dot(wi, layers.coat_frame[2])));
    return max(seen, lit);
}

float sheen_cover(Layers layers, vec3 wo, vec3 wi) {
    bool wi_inside = wi.z < 0.0 != layers.inside;
    float seen = layers.inside ? 0.0 : sheen_albedo(layers.sheen_roughness, wo.z);
    float lit = wi_inside ? 0.0 : sheen_albedo(layers.sheen_roughness, abs(wi.z));
    return max_component(layers.sheen_color) * max(seen, lit);
}

// The lobes of the layers themselves, times the cosine. wo and wi are above the surface.
vec3 evaluate_sheen(Layers layers, vec3 wo, vec3 wi) {
    if (layers.inside || layers.sheen_color == vec3(0.0)) { return vec3(0.0); }
    // Where the fitted shadowing lets an albedo exceed 1, the lobe is scaled down to that.
    float largest = max(
        lookup_sheen_table(wo.z, layers.sheen_roughness), lookup_sheen_table(wi.z, layers.sheen_roughness)
    );
    return layers.sheen_color * (evaluate_sheen(sheen_alpha(layers.sheen_roughness), wo, wi) / max(largest, 1.0));
}

float coat_fresnel(Layers layers, float cosine) {
    return layers.coat * fresnel(vec3(COAT_F0), cosine).x * (1.0 + COAT_F0 * layers.coat_multiscatter);
}

float evaluate_coat(Layers layers, vec3 wi) {
    vec3 coat_wi = wi * layers.coat_frame;
    if (!(layers.coat > 0.0) || is_mirror_coat(layers) || !(coat_wi.z > 0.0)) { return 0.0; }
    vec3 half_vector = normalize(layers.coat_wo + coat_wi);
    float V = V_SmithGGXCorrelated(layers.coat_roughness, layers.coat_wo.z, coat_wi.z);
    return coat_fresnel(layers, dot(coat_wi, half_vector)) * D_GGX(layers.coat_roughness, half_vector) * V * coat_wi.z;
}

float coat_pdf(Layers layers, vec3 wi) {
    vec3 coat_wi = wi * layers.coat_frame;
    if (!(layers.coat > 0.0) || is_mirror_coat(layers) || !(coat_wi.z > 0.0)) { return 0.0; }
    return layers.coat_pdf_per_d * D_GGX(layers.coat_roughness, normalize(layers.coat_wo + coat_wi));
}

vec3 sample_coat(Layers layers, vec2 u) {
    vec3 wo = layers.coat_wo;
    vec3 wi = is_mirror_coat(layers) ? vec3(-wo.xy, wo.z) : sample_ggx_vndf(wo, layers.coat_roughness, u);
    return wi.z > 0.0 ? layers.coat_frame * wi : vec3(0.0);
}

#endif
