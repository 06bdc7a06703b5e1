// A material seen from one direction: what its BRDF needs for all incoming directions, and the albedo of its lobes.
#ifndef SCENE_PREPARED_BRDF_GLSL
#define SCENE_PREPARED_BRDF_GLSL

#include "common/math.glsl"
#include "generated/settings/layering.glsl"
#include "scene/anisotropy.glsl"
#include "scene/brdf_table.glsl"
#include "scene/glass.glsl"
#include "scene/layers.glsl"
#include "scene/microfacet.glsl"
#include "scene/surface.glsl"

layout(constant_id = brdf_layering_id) const uint brdf_layering = LAYERING_CONSERVING;
// Every surface is base_color / pi, for comparison with closed forms.
layout(constant_id = brdf_lambert_id) const bool brdf_lambert = false;

const bool HAS_LOBES = SCENE_GLASS || SCENE_LAYERS;
// By how much A and B of an anisotropic lobe exceed those of the table at most, over the square of its strength.
const vec2 ANISOTROPY_BOUND = vec2(0.38, 0.67);

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
    // With which sample_brdf takes the specular lobe instead of the diffuse one.
    float specular_probability;
    float layer_weight;  // of a dielectric's specular lobe
    float transmission;  // the share of the dielectric that is glass
    // Where HAS_LOBES:
    float anisotropy;  // strength
    vec2 anisotropic_roughness;
    vec2 anisotropy_direction;
    Layers layers;
    Glass glass;
    vec3 lobe_probabilities;  // with which sample_brdf takes the coat, sheen and glass
};

// The roughness along and across the direction of anisotropy: KHR_materials_anisotropy.
vec2 anisotropic_roughness(ResolvedMaterial material) {
    return vec2(mix(material.roughness, 1.0, square(material.lobes.anisotropy)), material.roughness);
}

// The perceptual roughness under which tables have the albedo of the specular lobe: for an anisotropic lobe that of the
// same mean squared roughness.
float table_roughness(ResolvedMaterial material) {
    if (!SCENE_LAYERS || material.lobes.anisotropy == 0.0) { return material.perceptual_roughness; }
    vec2 roughness = anisotropic_roughness(material);
    return sqrt(sqrt(0.5 * dot(roughness, roughness)));
}

vec2 albedo_terms(bool mirror, float perceptual_roughness, float cosine) {
    return mirror ? mirror_albedo(cosine) : lookup_brdf_table(cosine, perceptual_roughness);
}

vec3 to_anisotropy(Brdf brdf, vec3 v) {
    vec2 along = brdf.anisotropy_direction;
    return vec3(dot(along, v.xy), along.x * v.y - along.y * v.x, v.z);
}

vec3 from_anisotropy(Brdf brdf, vec3 v) {
    vec2 along = brdf.anisotropy_direction;
    return vec3(along * v.x + vec2(-along.y, along.x) * v.y, v.z);
}

// A and B towards a direction. At grazing angles an anisotropic lobe has the albedo of its roughness in that direction.
vec2 albedo_terms(Brdf brdf, vec3 w) {
    if (!SCENE_LAYERS || brdf.mirror) { return albedo_terms(brdf.mirror, brdf.perceptual_roughness, w.z); }
    vec3 mean = vec3(brdf.anisotropic_roughness, square(brdf.perceptual_roughness));
    return lookup_brdf_table(w.z, sqrt(length(mean * to_anisotropy(brdf, w))));
}

// The share of uniform light that a dielectric's specular lobe reflects towards a direction, from A and B there. The
// factors of an anisotropic lobe bound its A and B over those of the table, measured for all directions, so that no
// energy is gained.
vec3 dielectric_albedo(Brdf brdf, vec2 ab) {
    vec3 albedo = specular_albedo(brdf.dielectric_f0, ab);
    if (!SCENE_LAYERS || brdf.mirror) { return brdf.layer_weight * albedo; }
    vec3 reflected = brdf.dielectric_f0 * ab.x;
    vec3 excess = (ANISOTROPY_BOUND.x * reflected + ANISOTROPY_BOUND.y * ab.y) / max(reflected + ab.y, 1e-30);
    return brdf.layer_weight * min(albedo * (1.0 + square(brdf.anisotropy) * excess), 1.0);
}

// `cosine` is that of the direction from which the surface is seen.
Glass prepare_glass(ResolvedMaterial material, float cosine) {
    MaterialLobes lobes = material.lobes;
    bool mirror = material.roughness <= MIRROR_ROUGHNESS;
    // Where nothing is bent, a rough boundary would have no microfacet normals.
    float ior = mirror ? lobes.ior : max(lobes.ior, 1.005);
    Glass glass;
    glass.weight = SCENE_GLASS ? lobes.transmission * (1.0 - material.metallic) : 0.0;
    glass.eta = lobes.inside ? 1.0 / ior : ior;
    glass.thin = !lobes.solid;
    glass.roughness = material.roughness;
    glass.color = lobes.passed_straight ? vec3(0.0) : material.base_color;
    glass.tint = glass_tint(ior, lobes.specular_weight * reflectance_f0(material.reflectance));
    glass.compensation = vec3(1.0);
    if (glass.weight > 0.0 && !mirror) {
        vec2 ab = lookup_brdf_table(cosine, material.perceptual_roughness);
        vec3 albedo = vec3(ab.x + ab.y);
        if (!glass.thin) {
            vec2 ends = lookup_glass_table(glass.eta, cosine, material.perceptual_roughness);
            albedo = mix(vec3(ends.x), vec3(ends.y), glass.tint);
        }
        glass.compensation = 1.0 / albedo;
    }
    return glass;
}

// The share of uniform incoming light that each lobe reflects towards a direction.
struct LobeAlbedos {
    vec3 diffuse;
    vec3 specular;
};

LobeAlbedos lobe_albedos(ResolvedMaterial material, float cosine) {
    if (brdf_lambert) { return LobeAlbedos(material.base_color, vec3(0.0)); }
    vec2 ab = albedo_terms(material.roughness <= MIRROR_ROUGHNESS, table_roughness(material), cosine);
    vec3 f0 = reflectance_f0(material.reflectance);
    vec3 dielectric = specular_albedo(f0, ab);
    if (SCENE_LAYERS) { dielectric *= material.lobes.specular_weight; }
    vec3 through = 1.0 - dielectric;
    if (brdf_layering == LAYERING_FRESNEL_PRODUCT) {
        // 20/21 (1 - f0) is the cosine-weighted mean of 1 - fresnel over the hemisphere.
        through = (1.0 - fresnel(f0, cosine)) * (1.0 - f0) * (20.0 / 21.0);
    }
    through *= material.base_color * (1.0 - material.metallic);
    vec3 metal = specular_albedo(material.base_color, ab);
    if (!SCENE_GLASS && !SCENE_LAYERS) { return LobeAlbedos(through, mix(dielectric, metal, material.metallic)); }
    MaterialLobes lobes = material.lobes;
    Glass glass = prepare_glass(material, cosine);
    vec3 reflected = glass_fresnel(glass, cosine);
    LobeAlbedos albedos = LobeAlbedos(
        through * (1.0 - lobes.transmission),
        mix(dielectric * (1.0 - lobes.transmission), metal, material.metallic)
            + glass.weight * mix(glass.color, vec3(1.0), reflected)
    );
    if (lobes.inside) { return albedos; }
    float coat = coat_albedo(lobes.coat, lobes.coat_roughness, cosine);
    float sheen = sheen_albedo(lobes.sheen_roughness, cosine);
    float below = (1.0 - coat) * (1.0 - max_component(lobes.sheen_color) * sheen);
    return LobeAlbedos(
        albedos.diffuse * below + lobes.sheen_color * (sheen * (1.0 - coat)), albedos.specular * below + coat
    );
}

// What scenes without glass and layers don't need. `base` is the luminance that all other lobes reflect.
void prepare_lobes(inout Brdf brdf, ResolvedMaterial material, vec3 wo, float base) {
    MaterialLobes lobes = material.lobes;
    if (SCENE_LAYERS && !brdf.mirror) {
        brdf.pdf_per_d = ggx_vndf_pdf_per_d(to_anisotropy(brdf, wo), brdf.anisotropic_roughness);
        if (lobes.anisotropy > 0.0) {
            brdf.multiscatter = 1.0 / lookup_anisotropy_table(
                to_anisotropy(brdf, wo), material.perceptual_roughness, lobes.anisotropy
            ) - 1.0;
        }
    }

    brdf.layers = prepare_layers(lobes, wo);
    brdf.glass = prepare_glass(material, wo.z);
    vec3 reflected = glass_fresnel(brdf.glass, wo.z);
    float glass = brdf.glass.weight * luminance(mix(brdf.glass.color, vec3(1.0), reflected));
    float coat = 0.0, sheen = 0.0, below_sheen = 1.0;
    if (!lobes.inside) {
        coat = coat_albedo(brdf.layers.coat, lobes.coat_roughness, brdf.layers.coat_wo.z);
        sheen = sheen_albedo(lobes.sheen_roughness, wo.z);
        below_sheen = 1.0 - max_component(lobes.sheen_color) * sheen;
    }
    vec3 below_coat = vec3(luminance(lobes.sheen_color) * sheen, vec2(glass, base) * below_sheen);
    vec4 shares = vec4(coat, below_coat * (1.0 - coat));
    float sum = shares.x + shares.y + shares.z + shares.w;
    brdf.lobe_probabilities = sum > 0.0 ? shares.xyz / sum : vec3(0.0);
}

// A surface that reflects all light evenly.
Brdf white_diffuse_brdf() {
    Brdf brdf;
    brdf.diffuse_color = vec3(1.0);
    brdf.dielectric_f0 = brdf.metal_f0 = vec3(0.0);
    brdf.metallic = brdf.roughness = brdf.perceptual_roughness = 1.0;  // a metal has no layer above its diffuse lobe
    brdf.mirror = true;  // of a black metal: there is no specular lobe
    brdf.multiscatter = brdf.pdf_per_d = brdf.specular_probability = 0.0;
    brdf.layer_weight = 1.0;
    brdf.transmission = 0.0;
    if (HAS_LOBES) {
        brdf.lobe_probabilities = vec3(0.0);
        brdf.layers = prepare_layers(NO_LOBES, vec3(0.0, 0.0, 1.0));
        brdf.glass.weight = 0.0;
    }
    return brdf;
}

Brdf prepare_brdf(ResolvedMaterial material, vec3 wo) {
    if (brdf_lambert) {
        Brdf lambert = white_diffuse_brdf();
        lambert.diffuse_color = material.base_color;
        return lambert;
    }
    Brdf brdf;
    brdf.metallic = material.metallic;
    brdf.roughness = material.roughness;
    brdf.perceptual_roughness = table_roughness(material);
    brdf.mirror = material.roughness <= MIRROR_ROUGHNESS;
    brdf.dielectric_f0 = reflectance_f0(material.reflectance);
    brdf.metal_f0 = material.base_color;
    brdf.diffuse_color = material.base_color * (1.0 - material.metallic);
    brdf.layer_weight = SCENE_LAYERS ? material.lobes.specular_weight : 1.0;
    brdf.transmission = SCENE_GLASS ? material.lobes.transmission : 0.0;
    if (SCENE_LAYERS && !brdf.mirror) {
        brdf.anisotropy = material.lobes.anisotropy;
        brdf.anisotropic_roughness = anisotropic_roughness(material);
        brdf.anisotropy_direction = material.lobes.anisotropy_direction;
    }
    vec2 ab = albedo_terms(brdf, wo);
    brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0;
    brdf.pdf_per_d = brdf.mirror ? 0.0 : ggx_vndf_pdf_per_d(wo, material.roughness);
    vec3 dielectric = dielectric_albedo(brdf, ab);
    vec3 specular = mix(
        dielectric * (1.0 - brdf.transmission), specular_albedo(brdf.metal_f0, ab), brdf.metallic
    );
    vec3 through = 1.0 - dielectric;
    brdf.diffuse_color *= 1.0 - brdf.transmission;
    float diffuse = luminance(brdf.diffuse_color * through);
    // Not above 1 by the rounding of a division.
    brdf.specular_probability = diffuse > 0.0 ? min(luminance(specular) / (luminance(specular) + diffuse), 1.0) : 1.0;
    if (brdf_layering == LAYERING_CONSERVING && brdf.metallic < 1.0) {
        // Differs from Solari: (1 - E(wo)) (1 - E(wi)) / (1 - E_average) is reciprocal and loses no energy
        mat3 averages = lookup_brdf_averages(brdf.perceptual_roughness);
        vec3 f0 = brdf.dielectric_f0;
        vec3 average = brdf.layer_weight * (averages[0] + f0 * (averages[1] + f0 * averages[2]));
        if (SCENE_LAYERS && !brdf.mirror) { average *= 1.0 + ANISOTROPY_BOUND.x * square(brdf.anisotropy); }
        brdf.diffuse_color *= through / (1.0 - average);
    }
    if (HAS_LOBES) { prepare_lobes(brdf, material, wo, luminance(specular) + diffuse); }
    return brdf;
}

// The same surface with its specular lobe alone.
Brdf without_diffuse_lobe(Brdf brdf) {
    brdf.diffuse_color = vec3(0.0);
    brdf.specular_probability = 1.0;
    if (HAS_LOBES) { brdf.layers.sheen_color = vec3(0.0); }
    return brdf;
}

#endif
