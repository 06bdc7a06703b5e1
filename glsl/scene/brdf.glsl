// The surface model: a Lambert lobe under a GGX lobe with multiple scattering, energy conserving; in scenes that have
// them, glass in place of the Lambert lobe, whose light may also leave on the other side, and layers over all.
// Directions point away from the surface, in the frame whose z axis is the shading normal (orthonormalize). Values
// include the cosine of wi. Each lobe stands in a file of scene/lobes, whose list.glsl names those that few materials
// have; this file loops over them. Sources: the papers named there.
//
// A coat has a normal of its own. Where a normal map tilts the base, the coat reflects directions below the base's
// shading normal too, as far as they are above the surface.
#ifndef SCENE_BRDF_GLSL
#define SCENE_BRDF_GLSL

#include "common/random.glsl"
#include "scene/lobes/diffuse.glsl"
#include "scene/lobes/specular.glsl"
#include "scene/material.glsl"

// With which probabilities sample_brdf takes the lobes that few materials have. The base takes the rest.
#define PROBABILITY(name, Lobe, Parameters, NONE, FEATURE, Bits) float name;
struct LobeProbabilities {
    LOBES(PROBABILITY)
};

// A material seen from one direction: what its lobes need for all incoming directions.
#define PREPARED(name, Lobe, Parameters, NONE, FEATURE, Bits) Lobe name;
struct Brdf {
    Diffuse diffuse;
    Specular specular;
    float specular_probability;  // with which sample_brdf takes the specular lobe instead of the diffuse one
    // Each where its scene feature is:
    ALL_LOBES(PREPARED)
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

// What a layer keeps from all that lies below it.
float cover_of(LobeAlbedo layer) { return max_component(layer.color) * layer.share; }

void add_albedo(inout LobeAlbedos sum, LobeAlbedo lobe, float passed) {
    vec3 albedo = lobe.color * (lobe.share * passed);
    if (lobe.diffuse) { sum.diffuse += albedo; } else { sum.specular += albedo; }
}

#define ADD_BASE_ALBEDO(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { add_albedo(below, lobe_albedo(material.name, base, wo), 1.0); }
// From the top to the bottom, as glTF orders layers: each takes from the light below it what it reflects. In scenes
// without layers too, or drivers would round products in another order there.
#define ADD_LAYER_ALBEDO(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    { \
        LobeAlbedo layer = lobe_albedo(material.name, base, wo); \
        add_albedo(above, layer, passed); \
        passed *= 1.0 - cover_of(layer); \
    }
LobeAlbedos lobe_albedos(ResolvedMaterial material, vec3 wo) {
    BaseMaterial base = material.base;
    float cosine = wo.z;
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
    float share = 1.0 - material.glass.transmission;
    LobeAlbedos below = LobeAlbedos(diffuse * share, mix(dielectric * share, metal, base.metallic));
    LobeAlbedos above = LobeAlbedos(vec3(0.0), vec3(0.0));
    float passed = 1.0;
    BASE_LOBES(ADD_BASE_ALBEDO)
    LAYERS(ADD_LAYER_ALBEDO)
    return LobeAlbedos(below.diffuse * passed + above.diffuse, below.specular * passed + above.specular);
}

// ---- preparation -------------------------------------------------------------------------------------

LobeProbabilities no_lobes() {
    LobeProbabilities none;
#define ZERO(name, Lobe, Parameters, NONE, FEATURE, Bits) none.name = 0.0;
    LOBES(ZERO)
    return none;
}

void scale(inout LobeProbabilities shares, float factor) {
#define SCALE(name, Lobe, Parameters, NONE, FEATURE, Bits) shares.name *= factor;
    LOBES(SCALE)
}

float sum_of(LobeProbabilities shares) {
    float sum = 0.0;
#define SUM(name, Lobe, Parameters, NONE, FEATURE, Bits) sum += shares.name;
    LOBES(SUM)
    return sum;
}

// Prepares the lobes that few materials have, and chooses them by the luminance of the light that each reflects.
// `base` is that of all other lobes.
#define PREPARE(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { brdf.name = prepare_lobe(material.name, material.base, wo); }
#define SHARE_OF_BASE(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { \
        LobeAlbedo lobe = lobe_albedo(brdf.name, wo); \
        shares.name = luminance(lobe.color) * lobe.share; \
    }
#define SHARE_OF_LAYER(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { \
        LobeAlbedo layer = lobe_albedo(brdf.name, wo); \
        float passed = 1.0 - cover_of(layer); \
        scale(shares, passed); \
        base *= passed; \
        shares.name = luminance(layer.color) * layer.share; \
    }
void prepare_lobes(inout Brdf brdf, ResolvedMaterial material, vec3 wo, float base) {
    LobeProbabilities shares = no_lobes();
    LOBES(PREPARE)
    BASE_LOBES(SHARE_OF_BASE)
    LAYERS_FROM_BELOW(SHARE_OF_LAYER)
    float sum = sum_of(shares) + base;
#define DIVIDE(name, Lobe, Parameters, NONE, FEATURE, Bits) shares.name /= sum;
    if (sum > 0.0) { LOBES(DIVIDE) }
    brdf.probabilities = shares;
}

#define LEAVE_OUT_LOBE(name, Lobe, Parameters, NONE, FEATURE, Bits) if (FEATURE) { leave_out(brdf.name); }
// A surface that reflects the share `color` of all light evenly.
Brdf lambert_brdf(vec3 color) {
    Brdf brdf;
    brdf.diffuse = Diffuse(color);
    brdf.specular = no_specular();
    brdf.specular_probability = 0.0;
    if (SCENE_LOBES) {
        LOBES(LEAVE_OUT_LOBE)
        brdf.diffuse_transmission = DiffuseTransmission(Diffuse(vec3(0.0)), 0.0);
        brdf.probabilities = no_lobes();
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
#define REMOVE_DIFFUSE(name, Lobe, Parameters, NONE, FEATURE, Bits) if (FEATURE) { remove_diffuse(brdf.name); }
    LAYERS(REMOVE_DIFFUSE)
    return brdf;
}

// ---- values ------------------------------------------------------------------------------------------

// What lies below the layers, as far as they let its light through. A layer takes from the light below what it
// reflects, seen from whichever direction it reflects more to. This is reciprocal and gains no energy: Kulla and Conty
// (2017), and KHR_materials_sheen.
#define PASS(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { passed *= 1.0 - lobe_cover(brdf.name, wo, wi); }
vec3 below_layers(Brdf brdf, vec3 value, vec3 wo, vec3 wi) {
    if (!SCENE_LAYERS || value == vec3(0.0)) { return value; }
    float passed = 1.0;
    LAYERS(PASS)
    return value * passed;
}

// The layers' own light of one kind, with that of a base which reflects `value` below them.
#define ADD_DIFFUSE_LAYER(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { own += diffuse_value(brdf.name, wo, wi) * passed; } \
    PASS(name, Lobe, Parameters, NONE, FEATURE, Bits)
#define ADD_SPECULAR_LAYER(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { own += specular_value(brdf.name, wo, wi) * passed; } \
    PASS(name, Lobe, Parameters, NONE, FEATURE, Bits)
#define ADD_SPECULAR(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { value += specular_value(brdf.name, wo, wi); }

// Whether wi, below the shading normal, is below the surface too, where the base may transmit light.
bool is_below_surface(Brdf brdf, vec3 wi) { return wi.z < 0.0 && !(SCENE_LAYERS && is_above_surface(brdf.coat, wi)); }

// The light of diffuse lobes, of the base and of layers such as sheen.
vec3 evaluate_diffuse_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (SCENE_DIFFUSE_TRANSMISSION && wo.z > 0.0 && is_below_surface(brdf, wi)) {
        vec3 value = evaluate_diffuse_transmission(brdf.diffuse_transmission, brdf.specular, wo, wi);
        return below_layers(brdf, value, wo, wi);
    }
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_diffuse(brdf.diffuse, brdf.specular, wo, wi);
    if (lambertian_surfaces || !SCENE_LAYERS) { return value; }
    vec3 own = vec3(0.0);
    float passed = 1.0;
    LAYERS(ADD_DIFFUSE_LAYER)
    return value * passed + own;
}

// The light of all other lobes. It is 0 for the one direction to which a mirror reflects, smooth glass refracts: only
// sample_brdf finds it.
vec3 evaluate_specular_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (lambertian_surfaces || !(wo.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_specular(brdf.specular, wo, wi);
    if (wi.z > 0.0 || is_below_surface(brdf, wi)) { BASE_LOBES(ADD_SPECULAR) }
    if (!SCENE_LAYERS) { return value; }
    vec3 own = vec3(0.0);
    float passed = 1.0;
    LAYERS(ADD_SPECULAR_LAYER)
    return value * passed + own;
}

vec3 brdf_times_cosine(Brdf brdf, vec3 wo, vec3 wi) {
    return evaluate_diffuse_brdf(brdf, wo, wi) + evaluate_specular_brdf(brdf, wo, wi);
}

// ---- sampling ----------------------------------------------------------------------------------------

#define REST(name, Lobe, Parameters, NONE, FEATURE, Bits) rest -= chosen.name;
#define ADD_PDF(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE && chosen.name > 0.0) { pdf += chosen.name * lobe_pdf(brdf.name, wo, wi); }
// The density with which sample_brdf chooses wi, in solid angle.
float brdf_pdf(Brdf brdf, vec3 wo, vec3 wi) {
    bool above = wi.z > 0.0;
    if (!(wo.z > 0.0) || !(above || SCENE_TRANSMISSION || SCENE_LAYERS)) { return 0.0; }
    float pdf = above ? mix(diffuse_pdf(wi), specular_pdf(brdf.specular, wo, wi), brdf.specular_probability) : 0.0;
    if (SCENE_DIFFUSE_TRANSMISSION) {
        pdf += (1.0 - brdf.specular_probability) * diffuse_transmission_pdf(brdf.diffuse_transmission, wi);
    }
    if (!SCENE_LOBES) { return pdf; }
    LobeProbabilities chosen = brdf.probabilities;
    float rest = 1.0;
    LOBES(REST)
    pdf *= max(rest, 0.0);
    LOBES(ADD_PDF)
    return pdf;
}

// The largest perceptual roughness of the layers that there are, 0 if they are delta lobes.
#define SPREAD(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { spread = max(spread, lobe_spread(brdf.name, brdf.probabilities.name)); }
float layers_spread(Brdf brdf) {
    float spread = 0.0;
    LAYERS(SPREAD)
    return spread;
}

// Whether the base, or the whole surface, reflects in one direction alone, which no light sample has.
bool has_delta_base(Brdf brdf) { return is_mirror(brdf.specular) && brdf.specular_probability == 1.0; }
bool is_delta(Brdf brdf) { return has_delta_base(brdf) && layers_spread(brdf) == 0.0; }

BrdfSample without_values(vec3 wi, vec3 weight, float pdf, bool diffuse) {
    return BrdfSample(wi, weight, pdf, diffuse, vec3(0.0), vec3(0.0));
}

BrdfSample invalid_sample() { return without_values(vec3(0.0), vec3(0.0), 0.0, false); }
BrdfSample delta_sample(vec3 wi, vec3 weight) { return without_values(wi, weight, INFINITY, false); }

// A direction that a lobe proposes, for weigh_sample.
const float NOT_WEIGHED = -1.0;
BrdfSample propose(vec3 wi, bool diffuse) { return without_values(wi, vec3(0.0), NOT_WEIGHED, diffuse); }

// The same of a lobe that only reflects: what it sends below the surface is no sample of one that transmits, nor, below
// the shading normal, of a coat.
BrdfSample propose_reflection(vec3 wi) {
    return (SCENE_TRANSMISSION || SCENE_LAYERS) && !(wi.z > 0.0) ? invalid_sample() : propose(wi, false);
}

BrdfSample weigh_sample(Brdf brdf, vec3 wo, vec3 wi, bool diffuse) {
    float pdf = brdf_pdf(brdf, wo, wi);
    vec3 diffuse_value = evaluate_diffuse_brdf(brdf, wo, wi), specular_value = evaluate_specular_brdf(brdf, wo, wi);
    vec3 weight = pdf > 0.0 ? (diffuse_value + specular_value) / pdf : vec3(0.0);
    return BrdfSample(wi, weight, pdf, diffuse, diffuse_value, specular_value);
}

// A proposal of one of the lobes that few materials have. `choice` is below the sum of their probabilities.
#define DRAW(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE && probability == 0.0 && choice < chosen.name) { \
        probability = chosen.name; \
        drawn = sample_lobe(brdf.name, wo, min(choice / probability, 0.99999994), u); \
    } \
    choice -= chosen.name;
BrdfSample propose_by_lobes(Brdf brdf, vec3 wo, float choice, vec2 u) {
    LobeProbabilities chosen = brdf.probabilities;
    LobeSample drawn = invalid_lobe_sample();  // stays so where a difference was rounded, once in ten million samples
    float probability = 0.0;
    LAYERS(DRAW)
    bool below = probability == 0.0;
    BASE_LOBES(DRAW)
    if (!drawn.valid) { return invalid_sample(); }
    if (!drawn.delta) { return propose(drawn.wi, drawn.diffuse); }
    if (below && !(drawn.wi.z > 0.0 || is_below_surface(brdf, drawn.wi))) { return invalid_sample(); }
    vec3 weight = drawn.color * (drawn.share / probability);
    return delta_sample(drawn.wi, below ? below_layers(brdf, weight, wo, drawn.wi) : weight);
}

BrdfSample propose_sample(Brdf brdf, vec3 wo, float choice, vec2 u) {
    float base_probability = 1.0;
    if (SCENE_LOBES) {
        LobeProbabilities chosen = brdf.probabilities;
        float others = sum_of(chosen);
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
