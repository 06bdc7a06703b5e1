// A material seen from one direction: what its BRDF needs for all incoming directions, and the albedo of its lobes.
#ifndef SCENE_PREPARED_BRDF_GLSL
#define SCENE_PREPARED_BRDF_GLSL

#include "scene/lobes/diffuse.glsl"
#include "scene/lobes/specular.glsl"
#include "scene/lobes/types.glsl"

// What layers reflect, and let pass to what lies below them, towards a direction. Each layer takes from the light below
// what it reflects, as glTF orders them: a coat over sheen over all else.
struct LayerAlbedos {
    float coat;
    float sheen;        // of white fibers, without the coat
    float below_sheen;
};

const LayerAlbedos NO_LAYERS = LayerAlbedos(0.0, 0.0, 1.0);

// `coat` is its weight; `cosine` and `coat_cosine` are those of the direction with the two normals.
LayerAlbedos layer_albedos(MaterialLobes lobes, float coat, float cosine, float coat_cosine) {
    if (lobes.inside) { return NO_LAYERS; }
    float sheen = sheen_albedo(lobes.sheen_roughness, cosine);
    return LayerAlbedos(
        coat_albedo(coat, lobes.coat_roughness, coat_cosine), sheen, 1.0 - max_component(lobes.sheen_color) * sheen
    );
}

// The share of uniform incoming light that each kind of lobe reflects towards a direction.
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
    vec3 through = diffuse_albedo(material, dielectric, cosine);
    vec3 metal = specular_albedo(material.base_color, ab);
    if (!SCENE_GLASS && !SCENE_LAYERS) { return LobeAlbedos(through, mix(dielectric, metal, material.metallic)); }
    MaterialLobes lobes = material.lobes;
    Glass glass = prepare_glass(material, cosine);
    LobeAlbedos albedos = LobeAlbedos(
        through * (1.0 - lobes.transmission),
        mix(dielectric * (1.0 - lobes.transmission), metal, material.metallic)
            + glass.weight * glass_albedo(glass, cosine)
    );
    LayerAlbedos layers = layer_albedos(lobes, lobes.coat, cosine, cosine);
    float below = (1.0 - layers.coat) * layers.below_sheen;
    return LobeAlbedos(
        albedos.diffuse * below + lobes.sheen_color * (layers.sheen * (1.0 - layers.coat)),
        albedos.specular * below + layers.coat
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

    brdf.coat = prepare_coat(lobes, wo);
    brdf.sheen = prepare_sheen(lobes);
    brdf.glass = prepare_glass(material, wo.z);
    float glass = brdf.glass.weight * luminance(glass_albedo(brdf.glass, wo.z));
    LayerAlbedos layers = layer_albedos(lobes, brdf.coat.weight, wo.z, brdf.coat.wo.z);
    vec3 below_coat = vec3(luminance(lobes.sheen_color) * layers.sheen, vec2(glass, base) * layers.below_sheen);
    vec4 shares = vec4(layers.coat, below_coat * (1.0 - layers.coat));
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
        brdf.coat = prepare_coat(NO_LOBES, vec3(0.0, 0.0, 1.0));
        brdf.sheen = prepare_sheen(NO_LOBES);
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
    if (HAS_LOBES) { brdf.sheen.color = vec3(0.0); }
    return brdf;
}

#endif
