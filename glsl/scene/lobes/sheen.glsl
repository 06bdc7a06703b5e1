// The Charlie sheen lobe, of fibers that stand on a surface: Estevez and Kulla, "Production Friendly Microfacet Sheen
// BRDF" (2017), with the visibility term of that paper, as KHR_materials_sheen recommends.
#ifndef SCENE_LOBES_SHEEN_GLSL
#define SCENE_LOBES_SHEEN_GLSL

#include "common/random.glsl"
#include "scene/base_material.glsl"
#include "scene/brdf_table.glsl"
#include "scene/lobes/interface.glsl"

const float MIN_SHEEN_ROUGHNESS = 0.07;  // perceptual; smoother sheen would be a line at the horizon

float sheen_alpha(float perceptual_roughness) { return square(max(perceptual_roughness, MIN_SHEEN_ROUGHNESS)); }

float sheen_distribution(float alpha, vec3 half_vector) {
    float sine = length(half_vector.xy);
    return (2.0 + 1.0 / alpha) * pow(sine, 1.0 / alpha) * (0.5 * INVERSE_PI);
}

// The logarithm of the fitted shadowing term, up to a cosine of 0.5.
float sheen_shadowing_fit(float alpha, float cosine) {
    float rough = square(1.0 - alpha);
    float a = mix(21.5473, 25.3245, rough), b = mix(3.82987, 3.32435, rough), c = mix(0.19823, 0.16801, rough);
    float d = mix(-1.97760, -1.27393, rough), e = mix(-4.32054, -4.85967, rough);
    return a / (1.0 + b * pow(cosine, c)) + d * cosine + e;
}

float sheen_lambda(float alpha, float cosine) {
    return cosine < 0.5
        ? exp(sheen_shadowing_fit(alpha, cosine))
        : exp(2.0 * sheen_shadowing_fit(alpha, 0.5) - sheen_shadowing_fit(alpha, 1.0 - cosine));
}

// The lobe of white fibers times the cosine of wi, both above the surface.
float evaluate_sheen(float alpha, vec3 wo, vec3 wi) {
    float shadowing = 1.0 + sheen_lambda(alpha, wo.z) + sheen_lambda(alpha, wi.z);
    return sheen_distribution(alpha, normalize(wo + wi)) / (4.0 * shadowing * max(wo.z, 1e-6));
}

// ---- of a material ----------------------------------------------------------------------------------

struct SheenParameters {
    vec3 color;
    float perceptual_roughness;
};

const SheenParameters NO_SHEEN = SheenParameters(vec3(0.0), 0.0);

SheenParameters resolve_sheen(Material material, TexturePoint point) {
    return SheenParameters(
        material.sheen_color * sampled_color_or_one(material.sheen_color_texture, point),
        material.sheen_roughness * sampled_or_one(material.sheen_roughness_texture, point, 3u)
    );
}

// color 3x8, roughness 8
uint pack_sheen(SheenParameters sheen) {
    return pack_unorm(sheen.color.x, 8u) | pack_unorm(sheen.color.y, 8u) << 8u | pack_unorm(sheen.color.z, 8u) << 16u
        | pack_unorm(sheen.perceptual_roughness, 8u) << 24u;
}

SheenParameters unpack_sheen(uint bits) {
    return SheenParameters(
        vec3(unpack_unorm(bits, 8u), unpack_unorm(bits >> 8u, 8u), unpack_unorm(bits >> 16u, 8u)),
        unpack_unorm(bits >> 24u, 8u)
    );
}

// ---- seen from a direction --------------------------------------------------------------------------

struct Sheen {
    vec3 color;
    float perceptual_roughness;
    bool inside;  // wo is below the fibers
};

Sheen prepare_sheen(SheenParameters parameters, bool inside) {
    return Sheen(parameters.color, parameters.perceptual_roughness, inside);
}

// The share of uniform incoming light that white sheen reflects.
float sheen_albedo(float perceptual_roughness, float cosine) {
    return min(lookup_sheen_table(cosine, perceptual_roughness), 1.0);
}

// The largest share of light that sheen keeps from what lies below it, for light from wi to wo. Directions within a
// volume don't pass it.
float lobe_cover(Sheen sheen, vec3 wo, vec3 wi) {
    bool wi_inside = wi.z < 0.0 != sheen.inside;
    float seen = sheen.inside ? 0.0 : sheen_albedo(sheen.perceptual_roughness, wo.z);
    float lit = wi_inside ? 0.0 : sheen_albedo(sheen.perceptual_roughness, abs(wi.z));
    return max_component(sheen.color) * max(seen, lit);
}

// Times the cosine. wo and wi are above the surface.
vec3 diffuse_value(Sheen sheen, vec3 wo, vec3 wi) {
    if (sheen.inside || sheen.color == vec3(0.0)) { return vec3(0.0); }
    // Where the fitted shadowing lets an albedo exceed 1, the lobe is scaled down to that.
    float roughness = sheen.perceptual_roughness;
    float largest = max(lookup_sheen_table(wo.z, roughness), lookup_sheen_table(wi.z, roughness));
    return sheen.color * (evaluate_sheen(sheen_alpha(roughness), wo, wi) / max(largest, 1.0));
}

float sheen_pdf() { return 0.5 * INVERSE_PI; }

vec3 sample_sheen(vec2 u) { return sample_uniform_hemisphere(u); }

// ---- as a row of scene/lobes/list.glsl ----------------------------------------------------------------

SheenParameters resolve_lobe(SheenParameters none, Material material, TexturePoint point) {
    return resolve_sheen(material, point);
}

uint pack_lobe(SheenParameters sheen, mat3 frame) { return pack_sheen(sheen); }
SheenParameters unpack_lobe(SheenParameters none, uint bits, mat3 frame) { return unpack_sheen(bits); }
void limit_roughness(inout SheenParameters sheen, float smallest) {}

Sheen prepare_lobe(SheenParameters parameters, BaseMaterial base, vec3 wo) {
    return prepare_sheen(parameters, base.inside);
}

LobeAlbedo lobe_albedo(SheenParameters sheen, BaseMaterial base, vec3 wo) {
    return LobeAlbedo(sheen.color, base.inside ? 0.0 : sheen_albedo(sheen.perceptual_roughness, wo.z), true);
}

LobeAlbedo lobe_albedo(Sheen sheen, vec3 wo) {
    return LobeAlbedo(sheen.color, sheen.inside ? 0.0 : sheen_albedo(sheen.perceptual_roughness, wo.z), true);
}

vec3 specular_value(Sheen sheen, vec3 wo, vec3 wi) { return vec3(0.0); }

float lobe_pdf(Sheen sheen, vec3 wo, vec3 wi) { return wi.z > 0.0 ? sheen_pdf() : 0.0; }
LobeSample sample_lobe(Sheen sheen, vec3 wo, float choice, vec2 u) { return spread_sample(sample_sheen(u), true); }
float lobe_spread(Sheen sheen, float probability) { return probability > 0.0 ? 1.0 : 0.0; }
void remove_diffuse(inout Sheen sheen) { sheen.color = vec3(0.0); }
void leave_out(inout Sheen sheen) { sheen = prepare_sheen(NO_SHEEN, false); }

#endif
