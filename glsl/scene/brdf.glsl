// The surface model: a Lambert lobe under a GGX lobe with multiple scattering, energy conserving; in scenes that have
// them, glass in place of the Lambert lobe and layers over all. Directions point away from the surface, in the frame
// whose z axis is the shading normal (orthonormalize). Values include the cosine of wi. Sources: the papers named at
// each function.
#ifndef SCENE_BRDF_GLSL
#define SCENE_BRDF_GLSL

#include "common/random.glsl"
#include "scene/prepared_brdf.glsl"

struct BrdfSample {
    vec3 wi;       // below the surface when the sample is invalid
    vec3 weight;   // BRDF times cosine over pdf; 0 when the sample is invalid
    float pdf;     // infinite for the direction of a mirror
    bool diffuse;  // whether the diffuse lobe proposed wi; weight and pdf are those of both lobes, except for a mirror
};

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
    if (!(wo.z > 0.0 && wi.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_diffuse_lobe(brdf, wo, wi);
    if (brdf_lambert || !SCENE_LAYERS) { return value; }
    vec3 sheen = evaluate_sheen(brdf.sheen, wo, wi);
    return below_layers(brdf, value, wo, wi) + sheen * (1.0 - coat_cover(brdf.coat, wo, wi));
}

// The light of all other lobes. It is 0 for the one direction to which a mirror reflects, smooth glass refracts: only
// sample_brdf finds it.
vec3 evaluate_specular_brdf(Brdf brdf, vec3 wo, vec3 wi) {
    if (brdf_lambert || !(wo.z > 0.0)) { return vec3(0.0); }
    vec3 value = evaluate_specular_lobe(brdf, wo, wi);
    if (SCENE_GLASS && brdf.glass.weight > 0.0 && !brdf.mirror) {
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
    if (!(wo.z > 0.0) || !(above || SCENE_GLASS)) { return 0.0; }
    float pdf = above ? mix(diffuse_pdf(wi), specular_pdf(brdf, wo, wi), brdf.specular_probability) : 0.0;
    if (!HAS_LOBES) { return pdf; }
    vec3 chosen = brdf.lobe_probabilities;
    pdf *= max(1.0 - chosen.x - chosen.y - chosen.z, 0.0);
    if (above && chosen.x > 0.0) { pdf += chosen.x * coat_pdf(brdf.coat, wi); }
    if (above) { pdf += chosen.y * sheen_pdf(); }
    if (chosen.z > 0.0 && !brdf.mirror) { pdf += chosen.z * glass_pdf(brdf.glass, wo, wi); }
    return pdf;
}

const BrdfSample INVALID_SAMPLE = BrdfSample(vec3(0.0), vec3(0.0), 0.0, false);

BrdfSample weigh_sample(Brdf brdf, vec3 wo, vec3 wi, bool diffuse) {
    float pdf = brdf_pdf(brdf, wo, wi);
    return BrdfSample(wi, pdf > 0.0 ? brdf_times_cosine(brdf, wo, wi) / pdf : vec3(0.0), pdf, diffuse);
}

// The same for a lobe that only reflects: what it sends below the surface is no sample of the glass.
BrdfSample weigh_reflection(Brdf brdf, vec3 wo, vec3 wi, bool diffuse) {
    if (SCENE_GLASS && !(wi.z > 0.0)) { return INVALID_SAMPLE; }
    return weigh_sample(brdf, wo, wi, diffuse);
}

// A sample by the coat, sheen or glass. `choice` is below the sum of their probabilities.
BrdfSample sample_lobes(Brdf brdf, vec3 wo, float choice, vec2 u) {
    vec3 chosen = brdf.lobe_probabilities;
    if (choice < chosen.x) {
        vec3 wi = sample_coat(brdf.coat, u);
        if (!is_mirror_coat(brdf.coat)) { return weigh_reflection(brdf, wo, wi, false); }
        vec3 weight = vec3(coat_fresnel(brdf.coat, brdf.coat.wo.z) / chosen.x);
        return wi.z > 0.0 ? BrdfSample(wi, weight, INFINITY, false) : INVALID_SAMPLE;
    }
    choice -= chosen.x;
    if (choice < chosen.y) { return weigh_sample(brdf, wo, sample_sheen(u), true); }
    choice = min((choice - chosen.y) / chosen.z, 0.99999994);
    vec3 smooth_weight;
    vec3 wi = sample_glass(brdf.glass, wo, choice, u, smooth_weight);
    if (wi.z == 0.0) { return INVALID_SAMPLE; }
    if (!brdf.mirror) { return weigh_sample(brdf, wo, wi, false); }
    smooth_weight = below_layers(brdf, smooth_weight * (brdf.glass.weight / chosen.z), wo, wi);
    return BrdfSample(wi, smooth_weight, INFINITY, false);
}

// `choice` decides which lobe proposes wi, `u` where in it; all are uniform in [0, 1).
BrdfSample sample_brdf(Brdf brdf, vec3 wo, float choice, vec2 u) {
    float base_probability = 1.0;
    if (HAS_LOBES) {
        vec3 chosen = brdf.lobe_probabilities;
        float others = chosen.x + chosen.y + chosen.z;
        if (choice < others) { return sample_lobes(brdf, wo, choice, u); }
        base_probability = 1.0 - others;
        choice = min((choice - others) / base_probability, 0.99999994);
    }
    bool diffuse = choice >= brdf.specular_probability;
    if (brdf.mirror && !diffuse) {
        vec3 wi = vec3(-wo.xy, wo.z);
        vec3 weight = specular_fresnel(brdf, wo.z) / brdf.specular_probability;
        if (HAS_LOBES) { weight = below_layers(brdf, weight / base_probability, wo, wi); }
        return BrdfSample(wi, weight, INFINITY, false);
    }
    vec3 wi = diffuse ? sample_diffuse_lobe(u) : sample_specular_lobe(brdf, wo, u);
    return weigh_reflection(brdf, wo, wi, diffuse);
}

BrdfSample sample_brdf(Brdf brdf, vec3 wo, inout uint rng) {
    float choice = rand_f(rng);
    return sample_brdf(brdf, wo, choice, rand_vec2f(rng));
}

#endif
