// The specular lobe: GGX with multiple scattering, of a metal or of a dielectric over the diffuse lobe.
#ifndef SCENE_LOBES_SPECULAR_GLSL
#define SCENE_LOBES_SPECULAR_GLSL

#include "scene/base_material.glsl"
#include "scene/brdf_table.glsl"
#include "scene/microfacet.glsl"

struct Specular {
    vec3 dielectric_f0;
    vec3 metal_f0;
    float metallic;
    float roughness;             // see is_mirror
    float perceptual_roughness;  // table_roughness
    float dielectric_weight;
    float dielectric_share;      // of a dielectric that other lobes leave to the base
    vec2 albedo_terms;           // A and B towards wo
    float multiscatter;          // 1 / Ess(wo) - 1, where Ess is the single-scattering albedo
    float pdf_per_d;             // ggx_vndf_pdf_per_d
    // Where SCENE_LAYERS, unless it is a mirror:
    float anisotropy;  // strength
    vec2 anisotropic_roughness;
    vec2 anisotropy_direction;
    // Where SCENE_IRIDESCENCE:
    ThinFilm film;
    vec3 dielectric_film;  // mean_film_fresnel towards wo; of metal likewise
    vec3 metal_film;
    FilmCover film_cover;
};

// Whether the lobe is a delta lobe. Computed where it is asked for: as a bool of the struct, NVIDIA's driver lost it in
// some threads of loops that trace rays (docs/driver_faults.md).
bool is_mirror(Specular specular) { return specular.roughness <= MIRROR_ROUGHNESS; }

// By how much A and B of an anisotropic lobe exceed those of the table at most, over the square of its strength.
const vec2 ANISOTROPY_BOUND = vec2(0.38, 0.67);

// The roughness along and across the direction of anisotropy: KHR_materials_anisotropy.
vec2 anisotropic_roughness(BaseMaterial base) {
    return vec2(mix(base.roughness, 1.0, square(base.anisotropy)), base.roughness);
}

// The perceptual roughness under which tables have the albedo of the specular lobe: for an anisotropic lobe that of the
// same mean squared roughness.
float table_roughness(BaseMaterial base) {
    if (!SCENE_LAYERS || base.anisotropy == 0.0) { return base.perceptual_roughness; }
    vec2 roughness = anisotropic_roughness(base);
    return sqrt(sqrt(0.5 * dot(roughness, roughness)));
}

vec3 to_anisotropy(Specular specular, vec3 v) {
    vec2 along = specular.anisotropy_direction;
    return vec3(dot(along, v.xy), along.x * v.y - along.y * v.x, v.z);
}

vec3 from_anisotropy(Specular specular, vec3 v) {
    vec2 along = specular.anisotropy_direction;
    return vec3(along * v.x + vec2(-along.y, along.x) * v.y, v.z);
}

// ---- albedo -----------------------------------------------------------------------------------------

// A and B towards a direction. At grazing angles an anisotropic lobe has the albedo of its roughness in that direction.
vec2 albedo_terms(Specular specular, vec3 w) {
    if (!SCENE_LAYERS || is_mirror(specular)) {
        return albedo_terms(is_mirror(specular), specular.perceptual_roughness, w.z);
    }
    vec3 mean = vec3(specular.anisotropic_roughness, square(specular.perceptual_roughness));
    return lookup_brdf_table(w.z, sqrt(length(mean * to_anisotropy(specular, w))));
}

// The share of uniform light that a dielectric's specular lobe reflects towards a direction, or keeps from what lies
// below it if it has a film, from A and B there. `cosine` is that of the direction. The factors of an anisotropic lobe
// bound its A and B over those of the table, measured for all directions, so that no energy is gained.
vec3 dielectric_albedo(Specular specular, vec2 ab, float cosine) {
    vec3 albedo = specular_albedo(specular.dielectric_f0, ab);
    if (SCENE_LAYERS && !is_mirror(specular)) {
        vec3 reflected = specular.dielectric_f0 * ab.x;
        vec3 excess = (ANISOTROPY_BOUND.x * reflected + ANISOTROPY_BOUND.y * ab.y) / max(reflected + ab.y, 1e-30);
        albedo = min(albedo * (1.0 + square(specular.anisotropy) * excess), 1.0);
    }
    if (SCENE_IRIDESCENCE && specular.film.weight > 0.0) {
        float roughness = square(specular.perceptual_roughness);
        vec3 mean = mean_film_fresnel(specular.film, specular.dielectric_f0, roughness, ab, cosine);
        albedo = mix(albedo, vec3(film_cover(specular.film_cover, mean, ab)), specular.film.weight);
    }
    return specular.dielectric_weight * albedo;
}

// The mean of that over directions, weighted by their cosines.
vec3 average_dielectric_albedo(Specular specular) {
    mat3 averages = lookup_brdf_averages(specular.perceptual_roughness);
    vec3 f0 = specular.dielectric_f0;
    vec3 average = specular.dielectric_weight * (averages[0] + f0 * (averages[1] + f0 * averages[2]));
    if (SCENE_LAYERS && !is_mirror(specular)) { average *= 1.0 + ANISOTROPY_BOUND.x * square(specular.anisotropy); }
    if (SCENE_IRIDESCENCE && specular.film.weight > 0.0) {
        vec3 covered = vec3(specular.dielectric_weight * specular.film_cover.average);
        average = mix(average, covered, specular.film.weight);
    }
    return average;
}

// ---- seen from a direction --------------------------------------------------------------------------

void prepare_film(inout Specular specular, ThinFilm film, float cosine) {
    specular.film = film;
    specular.metal_film = specular.dielectric_film = vec3(0.0);
    specular.film_cover = FilmCover(0.0, 0.0);
    if (film.weight == 0.0) { return; }
    vec2 ab = specular.albedo_terms;
    float rough = specular.perceptual_roughness, roughness = square(rough);
    if (specular.metallic > 0.0) {
        specular.metal_film = mean_film_fresnel(film, specular.metal_f0, roughness, ab, cosine);
    }
    if (specular.metallic < 1.0) {
        specular.dielectric_film = mean_film_fresnel(film, specular.dielectric_f0, roughness, ab, cosine);
        specular.film_cover = prepare_film_cover(film, specular.dielectric_f0, roughness, rough);
    }
}

// `share` of the dielectric is left to the base.
Specular prepare_specular(BaseMaterial base, float share, vec3 wo) {
    Specular specular;
    specular.metallic = base.metallic;
    specular.roughness = base.roughness;
    specular.perceptual_roughness = table_roughness(base);
    specular.dielectric_f0 = reflectance_f0(base.reflectance);
    specular.metal_f0 = base.color;
    specular.dielectric_weight = SCENE_LAYERS ? base.specular_weight : 1.0;
    specular.dielectric_share = share;
    bool anisotropic = SCENE_LAYERS && !is_mirror(specular);
    if (anisotropic) {
        specular.anisotropy = base.anisotropy;
        specular.anisotropic_roughness = anisotropic_roughness(base);
        specular.anisotropy_direction = base.anisotropy_direction;
    }
    specular.albedo_terms = albedo_terms(specular, wo);
    specular.multiscatter = 1.0 / (specular.albedo_terms.x + specular.albedo_terms.y) - 1.0;
    specular.pdf_per_d = is_mirror(specular) ? 0.0 : ggx_vndf_pdf_per_d(wo, base.roughness);
    if (anisotropic) {
        vec3 turned = to_anisotropy(specular, wo);
        specular.pdf_per_d = ggx_vndf_pdf_per_d(turned, specular.anisotropic_roughness);
        if (base.anisotropy > 0.0) {
            float albedo = lookup_anisotropy_table(turned, base.perceptual_roughness, base.anisotropy);
            specular.multiscatter = 1.0 / albedo - 1.0;
        }
    }
    if (SCENE_IRIDESCENCE) { prepare_film(specular, base.film, wo.z); }
    return specular;
}

// Reflects nothing: the lobe of a smooth black metal.
Specular no_specular() {
    Specular specular;
    specular.dielectric_f0 = specular.metal_f0 = vec3(0.0);
    specular.metallic = specular.perceptual_roughness = 1.0;
    specular.roughness = 0.0;
    specular.multiscatter = specular.pdf_per_d = 0.0;
    specular.dielectric_weight = specular.dielectric_share = 1.0;
    specular.film = NO_FILM;
    return specular;
}

// In one loop, since each copy of the code of films costs compilers time.
void add_film(Specular specular, float LdotH, inout vec3 dielectric, inout vec3 metal) {
    for (uint i = 0u; i < 2u; i++) {
        bool is_metal = i == 1u;
        if (specular.metallic == float(!is_metal)) { continue; }  // there is none
        vec3 reflected = film_fresnel(specular.film, is_metal ? specular.metal_f0 : specular.dielectric_f0, LdotH);
        vec3 mean = is_metal ? specular.metal_film : specular.dielectric_film;
        reflected *= 1.0 + mean * specular.multiscatter;
        if (is_metal) {
            metal = mix(metal, reflected, specular.film.weight);
        } else {
            dielectric = mix(dielectric, reflected, specular.film.weight);
        }
    }
}

// Fresnel of metal and dielectric, mixed last, with multiple scattering.
vec3 specular_fresnel(Specular specular, float LdotH) {
    vec3 dielectric = fresnel(specular.dielectric_f0, LdotH)
        * (1.0 + specular.dielectric_f0 * specular.multiscatter);
    vec3 metal = fresnel(specular.metal_f0, LdotH) * (1.0 + specular.metal_f0 * specular.multiscatter);
    if (SCENE_IRIDESCENCE && specular.film.weight > 0.0) { add_film(specular, LdotH, dielectric, metal); }
    if (SCENE_LOBES) { dielectric *= specular.dielectric_weight * specular.dielectric_share; }
    return mix(dielectric, metal, specular.metallic);
}

// D; pdf_per_d times it is the density of sample_specular.
float specular_distribution(Specular specular, vec3 half_vector) {
    if (SCENE_LAYERS) { return D_GGX(specular.anisotropic_roughness, to_anisotropy(specular, half_vector)); }
    return D_GGX(specular.roughness, half_vector);
}

// Without the one direction to which a mirror reflects.
vec3 evaluate_specular(Specular specular, vec3 wo, vec3 wi) {
    if (is_mirror(specular) || !(wi.z > 0.0)) { return vec3(0.0); }
    vec3 half_vector = normalize(wo + wi);
    float V = SCENE_LAYERS
        ? V_SmithGGXCorrelated(
            specular.anisotropic_roughness, to_anisotropy(specular, wo), to_anisotropy(specular, wi)
        )
        : V_SmithGGXCorrelated(specular.roughness, wo.z, wi.z);
    return specular_fresnel(specular, dot(wi, half_vector)) * (specular_distribution(specular, half_vector) * V * wi.z);
}

float specular_pdf(Specular specular, vec3 wo, vec3 wi) {
    if (is_mirror(specular) || !(wi.z > 0.0)) { return 0.0; }
    return specular.pdf_per_d * specular_distribution(specular, normalize(wo + wi));
}

vec3 sample_specular(Specular specular, vec3 wo, vec2 u) {
    if (!SCENE_LAYERS) { return sample_ggx_vndf(wo, specular.roughness, u); }
    return from_anisotropy(specular, sample_ggx_vndf(to_anisotropy(specular, wo), specular.anisotropic_roughness, u));
}

#endif
