// The surface model: a Lambert lobe under a GGX lobe with multiple scattering, energy conserving; in scenes that have
// them, glass in place of the Lambert lobe, whose light may also leave on the other side, and layers over all.
// Directions point away from the surface, in the frame whose z axis is the shading normal (orthonormalize). Values
// include the cosine of wi. Each lobe stands in a file of scene/lobes; this file has the list. Sources: the papers
// named there.
#ifndef SCENE_BRDF_GLSL
#define SCENE_BRDF_GLSL

#include "common/random.glsl"
#include "scene/lobes/diffuse.glsl"
#include "scene/lobes/specular.glsl"
#include "scene/material.glsl"

// With which probabilities sample_brdf takes the lobes that few materials have.
struct LobeProbabilities {
    float coat;
    float sheen;
    float glass;
};

// A material seen from one direction: what its lobes need for all incoming directions.
struct Brdf {
    Diffuse diffuse;
    Specular specular;
    float specular_probability;  // with which sample_brdf takes the specular lobe instead of the diffuse one
    // Where SCENE_LOBES:
    Coat coat;
    Sheen sheen;
    Glass glass;
    DiffuseTransmission diffuse_transmission;
    LobeProbabilities probabilities;
};

struct BrdfSample {
    vec3 wi;       // below the surface when the sample is invalid
    vec3 weight;   // BRDF times cosine over pdf; 0 when the sample is invalid
    float pdf;     // infinite for the direction of a mirror
    bool diffuse;  // whether the diffuse lobe proposed wi; weight and pdf are those of both lobes, except for a mirror
    // BRDF times cosine of the two kinds of lobes, as evaluate_diffuse_brdf and evaluate_specular_brdf have it; 0 for
    // the direction of a mirror.
    vec3 diffuse_value, specular_value;
};

// ---- albedo ------------------------------------------------------------------------------------------

// The share of uniform incoming light that each kind of lobe reflects towards a direction.
struct LobeAlbedos {
    vec3 diffuse;
    vec3 specular;
};

// Gives the albedos of a dielectric and a metal a film; returns what the dielectric keeps from the diffuse lobe.
vec3 add_film(BaseMaterial base, vec2 ab, float cosine, inout vec3 dielectric, inout vec3 metal) {
    float rough = table_roughness(base), roughness = square(rough);
    vec3 f0 = reflectance_f0(base.reflectance);
    vec3 mean = mean_film_fresnel(base.film, f0, roughness, ab, cosine);
    FilmCover film = prepare_film_cover(base.film, f0, roughness, rough);
    float weight = SCENE_LAYERS ? base.specular_weight : 1.0;
    vec3 cover = mix(dielectric, vec3(weight * film_cover(film, mean, ab)), base.film.weight);
    dielectric = mix(dielectric, weight * film_albedo(mean, ab), base.film.weight);
    vec3 metal_mean = mean_film_fresnel(base.film, base.color, roughness, ab, cosine);
    metal = mix(metal, film_albedo(metal_mean, ab), base.film.weight);
    return cover;
}

LobeAlbedos lobe_albedos(ResolvedMaterial material, float cosine) {
    BaseMaterial base = material.base;
    if (lambertian_surfaces || SCENE_UNLIT && base.unlit) { return LobeAlbedos(base.color, vec3(0.0)); }
    vec2 ab = albedo_terms(base.roughness <= MIRROR_ROUGHNESS, table_roughness(base), cosine);
    vec3 dielectric = specular_albedo(reflectance_f0(base.reflectance), ab);
    if (SCENE_LAYERS) { dielectric *= base.specular_weight; }
    vec3 diffuse = diffuse_albedo(diffuse_color(material), base, dielectric, cosine);
    vec3 metal = specular_albedo(base.color, ab);
    if (SCENE_IRIDESCENCE && base.film.weight > 0.0) {
        vec3 cover = add_film(base, ab, cosine, dielectric, metal);
        diffuse = diffuse_albedo(diffuse_color(material), base, cover, cosine);
    }
    if (!SCENE_LOBES) { return LobeAlbedos(diffuse, mix(dielectric, metal, base.metallic)); }
    Glass glass = prepare_glass(material.glass, base, cosine);
    float share = 1.0 - material.glass.transmission;
    LobeAlbedos albedos = LobeAlbedos(
        diffuse * share,
        mix(dielectric * share, metal, base.metallic) + glass.weight * glass_albedo(glass, cosine)
    );
    LayerAlbedos layers = layer_albedos(material, material.coat.weight, cosine, cosine);
    float below = (1.0 - layers.coat) * layers.below_sheen;
    return LobeAlbedos(
        albedos.diffuse * below + material.sheen.color * (layers.sheen * (1.0 - layers.coat)),
        albedos.specular * below + layers.coat
    );
}

// ---- preparation -------------------------------------------------------------------------------------

// What scenes without glass and layers don't need. `base` is the luminance that all other lobes reflect.
void prepare_lobes(inout Brdf brdf, ResolvedMaterial material, vec3 wo, float base) {
    brdf.coat = prepare_coat(material.coat, material.base.inside, wo);
    brdf.sheen = prepare_sheen(material.sheen, material.base.inside);
    brdf.glass = prepare_glass(material.glass, material.base, wo.z);
    LayerAlbedos layers = layer_albedos(material, brdf.coat.weight, wo.z, brdf.coat.wo.z);
    float glass = brdf.glass.weight * luminance(glass_albedo(brdf.glass, wo.z));
    vec3 below_coat = vec3(luminance(material.sheen.color) * layers.sheen, vec2(glass, base) * layers.below_sheen);
    vec4 shares = vec4(layers.coat, below_coat * (1.0 - layers.coat));
    float sum = shares.x + shares.y + shares.z + shares.w;
    vec3 chosen = sum > 0.0 ? shares.xyz / sum : vec3(0.0);
    brdf.probabilities = LobeProbabilities(chosen.x, chosen.y, chosen.z);
}

// A surface that reflects the share `color` of all light evenly.
Brdf lambert_brdf(vec3 color) {
    Brdf brdf;
    brdf.diffuse = Diffuse(color);
    brdf.specular = no_specular();
    brdf.specular_probability = 0.0;
    if (SCENE_LOBES) {
        brdf.coat = prepare_coat(NO_COAT, false, vec3(0.0, 0.0, 1.0));
        brdf.sheen = prepare_sheen(NO_SHEEN, false);
        brdf.glass.weight = 0.0;
        brdf.diffuse_transmission = DiffuseTransmission(Diffuse(vec3(0.0)), 0.0);
        brdf.probabilities = LobeProbabilities(0.0, 0.0, 0.0);
    }
    return brdf;
}

Brdf prepare_brdf(ResolvedMaterial material, vec3 wo) {
    if (lambertian_surfaces || SCENE_UNLIT && material.base.unlit) { return lambert_brdf(material.base.color); }
    Brdf brdf;
    float share = SCENE_GLASS ? 1.0 - material.glass.transmission : 1.0;
    brdf.specular = prepare_specular(material.base, share, wo);
    vec2 ab = brdf.specular.albedo_terms;
    vec3 dielectric = dielectric_albedo(brdf.specular, ab, wo.z);
    vec3 color = diffuse_color(material) * share;
    vec3 reflected = color;
    if (SCENE_DIFFUSE_TRANSMISSION) {
        vec3 transmitted = transmitted_color(material) * share;
        reflected = max(color - transmitted, 0.0);
        brdf.diffuse_transmission = prepare_diffuse_transmission(transmitted, reflected, brdf.specular, dielectric);
        if (SCENE_DISPERSION) { brdf.diffuse_transmission.beyond.color *= material.glass.dispersed.transmitted_color; }
    }
    brdf.diffuse = prepare_diffuse(reflected, brdf.specular, dielectric);
    float diffuse = luminance(color * (1.0 - dielectric));
    vec3 metal = specular_albedo(brdf.specular.metal_f0, ab);
    if (SCENE_IRIDESCENCE && material.base.film.weight > 0.0) {
        metal = mix(metal, film_albedo(brdf.specular.metal_film, ab), material.base.film.weight);
    }
    float specular = luminance(mix(dielectric * share, metal, material.base.metallic));
    // Differs from Solari: lobes are chosen by the light that each reflects, colors included, not by Fresnel alone.
    // Not above 1 by the rounding of a division.
    brdf.specular_probability = diffuse > 0.0 ? min(specular / (specular + diffuse), 1.0) : 1.0;
    if (SCENE_LOBES) { prepare_lobes(brdf, material, wo, specular + diffuse); }
    return brdf;
}

// The same surface with its specular lobe alone.
Brdf without_diffuse_lobe(Brdf brdf) {
    brdf.diffuse.color = vec3(0.0);
    if (SCENE_DIFFUSE_TRANSMISSION) { brdf.diffuse_transmission.beyond.color = vec3(0.0); }
    brdf.specular_probability = 1.0;
    if (SCENE_LOBES) { brdf.sheen.color = vec3(0.0); }
    return brdf;
}

// ---- values ------------------------------------------------------------------------------------------

// What lies below the layers, as far as they let its light through. A layer takes from the light below what it
// reflects, seen from whichever direction it reflects more to. This is reciprocal and gains no energy: Kulla and Conty
// (2017), and KHR_materials_sheen.
vec3 below_layers(Brdf brdf, vec3 value, vec3 wo, vec3 wi) {
    if (!SCENE_LAYERS || value == vec3(0.0)) { return value; }
    return value * ((1.0 - sheen_cover(brdf.sheen, wo, wi)) * (1.0 - coat_cover(brdf.coat, wo, wi)));
}

// The light of the diffuse lobe and sheen.
vec3 evaluate_diffuse_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (SCENE_DIFFUSE_TRANSMISSION && wo.z > 0.0 && wi.z < 0.0) {
        vec3 value = evaluate_diffuse_transmission(brdf.diffuse_transmission, brdf.specular, wo, wi);
        return below_layers(brdf, value, wo, wi);
    }
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_diffuse(brdf.diffuse, brdf.specular, wo, wi);
    if (lambertian_surfaces || !SCENE_LAYERS) { return value; }
    vec3 sheen = evaluate_sheen(brdf.sheen, wo, wi);
    return below_layers(brdf, value, wo, wi) + sheen * (1.0 - coat_cover(brdf.coat, wo, wi));
}

// The light of all other lobes. It is 0 for the one direction to which a mirror reflects, smooth glass refracts: only
// sample_brdf finds it.
vec3 evaluate_specular_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (lambertian_surfaces || !(wo.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_specular(brdf.specular, wo, wi);
    if (SCENE_GLASS && brdf.glass.weight > 0.0 && !is_mirror(brdf.specular)) {
        value += brdf.glass.weight * evaluate_glass(brdf.glass, wo, wi);
    }
    if (!SCENE_LAYERS) { return value; }
    return below_layers(brdf, value, wo, wi) + (wi.z > 0.0 ? evaluate_coat(brdf.coat, wi) : 0.0);
}

vec3 brdf_times_cosine(Brdf brdf, vec3 wo, vec3 wi) {
    return evaluate_diffuse_brdf(brdf, wo, wi) + evaluate_specular_brdf(brdf, wo, wi);
}

// ---- sampling ----------------------------------------------------------------------------------------

// The density with which sample_brdf chooses wi, in solid angle.
float brdf_pdf(Brdf brdf, vec3 wo, vec3 wi) {
    bool above = wi.z > 0.0;
    if (!(wo.z > 0.0) || !(above || SCENE_TRANSMISSION)) { return 0.0; }
    float pdf = above ? mix(diffuse_pdf(wi), specular_pdf(brdf.specular, wo, wi), brdf.specular_probability) : 0.0;
    if (SCENE_DIFFUSE_TRANSMISSION) {
        pdf += (1.0 - brdf.specular_probability) * diffuse_transmission_pdf(brdf.diffuse_transmission, wi);
    }
    if (!SCENE_LOBES) { return pdf; }
    LobeProbabilities chosen = brdf.probabilities;
    pdf *= max(1.0 - chosen.coat - chosen.sheen - chosen.glass, 0.0);
    if (above && chosen.coat > 0.0) { pdf += chosen.coat * coat_pdf(brdf.coat, wi); }
    if (above) { pdf += chosen.sheen * sheen_pdf(); }
    if (chosen.glass > 0.0 && !is_mirror(brdf.specular)) { pdf += chosen.glass * glass_pdf(brdf.glass, wo, wi); }
    return pdf;
}

// Whether the base, or the whole surface, reflects in one direction alone, which no light sample has.
bool has_delta_base(Brdf brdf) { return is_mirror(brdf.specular) && brdf.specular_probability == 1.0; }
bool is_delta(Brdf brdf) {
    return has_delta_base(brdf) && !(SCENE_LAYERS && (brdf.probabilities.sheen > 0.0 || is_rough_coat(brdf.coat)));
}

BrdfSample without_values(vec3 wi, vec3 weight, float pdf, bool diffuse) {
    return BrdfSample(wi, weight, pdf, diffuse, vec3(0.0), vec3(0.0));
}

BrdfSample invalid_sample() { return without_values(vec3(0.0), vec3(0.0), 0.0, false); }
BrdfSample delta_sample(vec3 wi, vec3 weight) { return without_values(wi, weight, INFINITY, false); }

// A direction that a lobe proposes, for weigh_sample.
const float NOT_WEIGHED = -1.0;
BrdfSample propose(vec3 wi, bool diffuse) { return without_values(wi, vec3(0.0), NOT_WEIGHED, diffuse); }

// The same of a lobe that only reflects: what it sends below the surface is no sample of one that transmits.
BrdfSample propose_reflection(vec3 wi) {
    return SCENE_TRANSMISSION && !(wi.z > 0.0) ? invalid_sample() : propose(wi, false);
}

BrdfSample weigh_sample(Brdf brdf, vec3 wo, vec3 wi, bool diffuse) {
    float pdf = brdf_pdf(brdf, wo, wi);
    vec3 diffuse_value = evaluate_diffuse_brdf(brdf, wo, wi), specular_value = evaluate_specular_brdf(brdf, wo, wi);
    vec3 weight = pdf > 0.0 ? (diffuse_value + specular_value) / pdf : vec3(0.0);
    return BrdfSample(wi, weight, pdf, diffuse, diffuse_value, specular_value);
}

// A proposal of one of the lobes that few materials have. `choice` is below the sum of their probabilities.
BrdfSample propose_by_lobes(Brdf brdf, vec3 wo, float choice, vec2 u) {
    LobeProbabilities chosen = brdf.probabilities;
    if (choice < chosen.coat) {
        vec3 wi = sample_coat(brdf.coat, u);
        if (!is_mirror_coat(brdf.coat)) { return propose_reflection(wi); }
        vec3 weight = vec3(coat_fresnel(brdf.coat, brdf.coat.wo.z) / chosen.coat);
        return wi.z > 0.0 ? delta_sample(wi, weight) : invalid_sample();
    }
    choice -= chosen.coat;
    if (choice < chosen.sheen) { return propose(sample_sheen(u), true); }
    choice = min((choice - chosen.sheen) / chosen.glass, 0.99999994);
    vec3 smooth_weight;
    vec3 wi = sample_glass(brdf.glass, wo, choice, u, smooth_weight);
    if (wi.z == 0.0) { return invalid_sample(); }
    if (!is_mirror(brdf.specular)) { return propose(wi, false); }
    smooth_weight = below_layers(brdf, smooth_weight * (brdf.glass.weight / chosen.glass), wo, wi);
    return delta_sample(wi, smooth_weight);
}

BrdfSample propose_sample(Brdf brdf, vec3 wo, float choice, vec2 u) {
    float base_probability = 1.0;
    if (SCENE_LOBES) {
        LobeProbabilities chosen = brdf.probabilities;
        float others = chosen.coat + chosen.sheen + chosen.glass;
        if (choice < others) { return propose_by_lobes(brdf, wo, choice, u); }
        base_probability = 1.0 - others;
        choice = min((choice - others) / base_probability, 0.99999994);
    }
    bool diffuse = choice >= brdf.specular_probability;
    if (is_mirror(brdf.specular) && !diffuse) {
        vec3 wi = vec3(-wo.xy, wo.z);
        vec3 weight = specular_fresnel(brdf.specular, wo.z) / brdf.specular_probability;
        if (SCENE_LOBES) { weight = below_layers(brdf, weight / base_probability, wo, wi); }
        return delta_sample(wi, weight);
    }
    vec3 wi = diffuse ? sample_diffuse(u) : sample_specular(brdf.specular, wo, u);
    if (SCENE_DIFFUSE_TRANSMISSION) {
        choice = (choice - brdf.specular_probability) / (1.0 - brdf.specular_probability);
        if (diffuse && choice < brdf.diffuse_transmission.probability) { wi.z = -wi.z; }
    }
    return diffuse ? propose(wi, true) : propose_reflection(wi);
}

// `choice` decides which lobe proposes wi, `u` where in it; all are uniform in [0, 1). All lobes are evaluated in one
// place, because drivers inline functions wherever they are called.
BrdfSample sample_brdf(Brdf brdf, vec3 wo, float choice, vec2 u) {
    BrdfSample proposed = propose_sample(brdf, wo, choice, u);
    return proposed.pdf == NOT_WEIGHED ? weigh_sample(brdf, wo, proposed.wi, proposed.diffuse) : proposed;
}

BrdfSample sample_brdf(Brdf brdf, vec3 wo, inout uint rng) {
    float choice = rand_f(rng);
    return sample_brdf(brdf, wo, choice, rand_vec2f(rng));
}

#endif
