// The surface model: a Lambert lobe under a GGX lobe with multiple scattering, energy conserving. All directions point
// away from the surface, in the frame whose z axis is the shading normal (orthonormalize). All values include the
// cosine of wi. Sources: the papers named at each function.
#ifndef SCENE_BRDF_GLSL
#define SCENE_BRDF_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
#include "generated/settings/layering.glsl"
#include "scene/brdf_table.glsl"
#include "scene/microfacet.glsl"
#include "scene/surface.glsl"

layout(constant_id = 0) const uint brdf_layering = LAYERING_CONSERVING;
// Every surface is base_color / pi, for comparison with closed forms.
layout(constant_id = 1) const bool brdf_lambert = false;

// A material seen from one direction.
struct Brdf {
    vec3 diffuse_color;  // for LAYERING_CONSERVING reduced by what the specular layer reflects towards wo
    vec3 dielectric_f0;
    vec3 metal_f0;
    float metallic;
    float roughness;
    float perceptual_roughness;
    bool mirror;
    float multiscatter;          // 1 / Ess(wo) - 1, where Ess is the single-scattering albedo
    float pdf_per_d;             // ggx_vndf_pdf_per_d
    float specular_probability;  // with which sample_brdf takes the specular lobe
};

struct BrdfSample {
    vec3 wi;       // below the surface when the sample is invalid
    vec3 weight;   // BRDF times cosine over pdf; 0 when the sample is invalid
    float pdf;     // infinite for the direction of a mirror
    bool diffuse;  // whether the diffuse lobe proposed wi; weight and pdf are those of both lobes, except for a mirror
};

// The Fresnel reflectance of a dielectric at normal incidence.
vec3 reflectance_f0(vec3 reflectance) { return 0.16 * reflectance * reflectance; }

// The directional albedo of GGX with multiple scattering, from the single-scattering albedo F0 A + B. Fdez-Aguero, "A
// Multiple-Scattering Microfacet Model for Real-Time Image-based Lighting" (JCGT 2019).
vec3 specular_albedo(vec3 f0, vec2 ab) {
    return min((f0 * ab.x + ab.y) * (1.0 + f0 * (1.0 / (ab.x + ab.y) - 1.0)), 1.0);  // not above 1 by rounding
}

// The share of uniform incoming light that each lobe reflects towards a direction.
struct LobeAlbedos {
    vec3 diffuse;
    vec3 specular;
};

LobeAlbedos lobe_albedos(ResolvedMaterial material, float cosine) {
    if (brdf_lambert) { return LobeAlbedos(material.base_color, vec3(0.0)); }
    vec2 ab = material.roughness <= MIRROR_ROUGHNESS
        ? mirror_albedo(cosine) : lookup_brdf_table(cosine, material.perceptual_roughness);
    vec3 f0 = reflectance_f0(material.reflectance);
    vec3 dielectric = specular_albedo(f0, ab);
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        // 20/21 (1 - f0) is the cosine-weighted mean of 1 - fresnel over the hemisphere.
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);
    }
    return LobeAlbedos(
        through * material.base_color * (1.0 - material.metallic),
        mix(dielectric, specular_albedo(material.base_color, ab), material.metallic)
    );
}

Brdf prepare_brdf(ResolvedMaterial material, vec3 wo) {
    Brdf brdf;
    brdf.metallic = material.metallic;
    brdf.roughness = material.roughness;
    brdf.perceptual_roughness = material.perceptual_roughness;
    brdf.mirror = material.roughness <= MIRROR_ROUGHNESS;
    brdf.dielectric_f0 = reflectance_f0(material.reflectance);
    brdf.metal_f0 = material.base_color;
    brdf.diffuse_color = material.base_color * (1.0 - material.metallic);
    brdf.specular_probability = 0.0;
    brdf.pdf_per_d = brdf.multiscatter = 0.0;
    if (brdf_lambert) {
        brdf.diffuse_color = material.base_color;
        return brdf;
    }
    vec2 ab = brdf.mirror ? mirror_albedo(wo.z) : lookup_brdf_table(wo.z, material.perceptual_roughness);
    brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0;
    brdf.pdf_per_d = brdf.mirror ? 0.0 : ggx_vndf_pdf_per_d(wo, material.roughness);
    vec3 dielectric_albedo = specular_albedo(brdf.dielectric_f0, ab);
    vec3 specular = mix(dielectric_albedo, specular_albedo(brdf.metal_f0, ab), brdf.metallic);
    vec3 through = 1.0 - dielectric_albedo;
    float diffuse = luminance(brdf.diffuse_color * through);
    // Not above 1 by the rounding of a division.
    brdf.specular_probability = diffuse > 0.0 ? min(luminance(specular) / (luminance(specular) + diffuse), 1.0) : 1.0;
    if (brdf_layering == LAYERING_CONSERVING && brdf.metallic < 1.0) {
        // Differs from Solari: (1 - E(wo)) (1 - E(wi)) / (1 - E_average) is reciprocal and loses no energy
        mat3 averages = lookup_brdf_averages(material.perceptual_roughness);
        vec3 f0 = brdf.dielectric_f0;
        vec3 average = averages[0] + f0 * (averages[1] + f0 * averages[2]);
        brdf.diffuse_color *= through / (1.0 - average);
    }
    return brdf;
}

// A surface that reflects all light evenly. As a metal without specular lobe it has no layer above the diffuse lobe.
const Brdf WHITE_DIFFUSE = Brdf(vec3(1.0), vec3(0.0), vec3(0.0), 1.0, 1.0, 1.0, true, 0.0, 0.0, 0.0);

// The same surface with its specular lobe alone.
Brdf without_diffuse_lobe(Brdf brdf) {
    brdf.diffuse_color = vec3(0.0);
    brdf.specular_probability = 1.0;
    return brdf;
}

vec3 evaluate_diffuse_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return vec3(0.0); }
    vec3 value = brdf.diffuse_color * (INVERSE_PI * wi.z);
    if (brdf_lambert || brdf.metallic == 1.0) { return value; }
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        return value * (1.0 - fresnel(brdf.dielectric_f0, wo.z)) * (1.0 - fresnel(brdf.dielectric_f0, wi.z));
    }
    vec2 ab = brdf.mirror ? mirror_albedo(wi.z) : lookup_brdf_table(wi.z, brdf.perceptual_roughness);
    return value * (1.0 - specular_albedo(brdf.dielectric_f0, ab));
}

// Fresnel of metal and dielectric, mixed last, with multiple scattering.
vec3 specular_fresnel(Brdf brdf, float LdotH) {
    vec3 dielectric = fresnel(brdf.dielectric_f0, LdotH) * (1.0 + brdf.dielectric_f0 * brdf.multiscatter);
    vec3 metal = fresnel(brdf.metal_f0, LdotH) * (1.0 + brdf.metal_f0 * brdf.multiscatter);
    return mix(dielectric, metal, brdf.metallic);
}

// Returns 0 for a mirror: only sample_brdf finds the one direction that it reflects to.
vec3 evaluate_specular_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (brdf_lambert || brdf.mirror || !(wo.z > 0.0 && wi.z > 0.0)) { return vec3(0.0); }
    vec3 half_vector = normalize(wo + wi);
    float D = D_GGX(brdf.roughness, half_vector);
    float V = V_SmithGGXCorrelated(brdf.roughness, wo.z, wi.z);
    return specular_fresnel(brdf, dot(wi, half_vector)) * (D * V * wi.z);
}

vec3 evaluate_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    return evaluate_diffuse_brdf(brdf, wo, wi) + evaluate_specular_brdf(brdf, wo, wi);
}

// The density with which sample_brdf chooses wi, in solid angle.
float brdf_pdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return 0.0; }
    float diffuse_pdf = INVERSE_PI * wi.z;
    float specular_pdf = brdf.mirror ? 0.0 : brdf.pdf_per_d * D_GGX(brdf.roughness, normalize(wo + wi));
    return mix(diffuse_pdf, specular_pdf, brdf.specular_probability);
}

// `choice` decides which lobe proposes wi, `u` where in it; all are uniform in [0, 1).
BrdfSample sample_brdf(Brdf brdf, vec3 wo, float choice, vec2 u) {
    if (brdf.mirror && choice < brdf.specular_probability) {
        vec3 weight = specular_fresnel(brdf, wo.z) / brdf.specular_probability;
        return BrdfSample(vec3(-wo.xy, wo.z), weight, INFINITY, false);
    }
    bool diffuse = choice >= brdf.specular_probability;
    vec3 wi = diffuse ? sample_cosine_hemisphere(u) : sample_ggx_vndf(wo, brdf.roughness, u);
    float pdf = brdf_pdf(brdf, wo, wi);
    return BrdfSample(wi, pdf > 0.0 ? evaluate_brdf(brdf, wo, wi) / pdf : vec3(0.0), pdf, diffuse);
}

BrdfSample sample_brdf(Brdf brdf, vec3 wo, inout uint rng) {
    float choice = rand_f(rng);
    return sample_brdf(brdf, wo, choice, rand_vec2f(rng));
}

#endif
