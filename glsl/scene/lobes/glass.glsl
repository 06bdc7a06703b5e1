// Glass: GGX reflection and refraction at the boundary of a solid, or through a thin wall, with the exact reflectance
// of dielectrics. Walter et al., "Microfacet Models for Refraction through Rough Surfaces" (2007).
//
// Radiance in glass is taken over the square of the index of refraction, which is constant along refracted rays. All
// light that reaches a camera is then as it would be otherwise, and white glass neither gains nor loses any.
#ifndef SCENE_LOBES_GLASS_GLSL
#define SCENE_LOBES_GLASS_GLSL

#include "scene/base_material.glsl"
#include "scene/brdf_table.glsl"
#include "scene/lobes/dispersion.glsl"
#include "scene/lobes/interface.glsl"
#include "scene/microfacet.glsl"

// ---- of a material ----------------------------------------------------------------------------------

struct GlassParameters {
    float transmission;  // the share of a dielectric's base that is glass instead of diffuse
    float ior;           // its index of refraction
    bool reflects_only;  // rays have taken the light that passes straight: remove_straight_transmission
    Dispersed dispersed;
};

const GlassParameters NO_GLASS = GlassParameters(0.0, 1.5, false, NOT_DISPERSED);

GlassParameters resolve_glass(Material material, TexturePoint point) {
    float transmission = material.transmission * sampled_or_one(material.transmission_texture, point, 0u);
    return GlassParameters(transmission, material.ior, false, NOT_DISPERSED);
}

const float LARGEST_IOR_RATIO = 0.75;  // (ior - 1) / (ior + 1) for an index of refraction of 7

// transmission 8, index of refraction 10
uint pack_glass(GlassParameters glass) {
    float ratio = (glass.ior - 1.0) / (glass.ior + 1.0) / LARGEST_IOR_RATIO;
    return pack_unorm(glass.transmission, 8u) | pack_unorm(ratio, 10u) << 8u;
}

GlassParameters unpack_glass(uint bits) {
    float ratio = LARGEST_IOR_RATIO * unpack_unorm(bits >> 8u, 10u);
    return GlassParameters(unpack_unorm(bits, 8u), (1.0 + ratio) / (1.0 - ratio), false, NOT_DISPERSED);
}

// ---- seen from a direction --------------------------------------------------------------------------

struct Glass {
    float weight;        // 0: the surface isn't made of glass
    float eta;           // the index of refraction below the surface over that above it, as seen by wo
    Dispersed dispersed; // its `reflected_iors` are etas too
    bool thin;           // light passes the wall without being bent
    float roughness;
    vec3 color;          // of the light that passes
    vec3 tint;           // of reflections
    ThinFilm film;       // on its outside
    vec3 film_f0;
    float film_share;    // of its reflections
    vec3 compensation;   // one over the albedo of single scattering: Turquin (2019)
};

vec3 glass_fresnel(Glass glass, float cosine) {
    float reflected = dielectric_fresnel(glass.eta, cosine);
    if (!(reflected < 1.0)) { return vec3(1.0); }
    vec3 bare = reflected * glass.tint;
    if (SCENE_DISPERSION && glass.dispersed.ior > 0.0) {
        vec3 etas = glass.dispersed.reflected_iors;
        bare.g = dielectric_fresnel(etas.g, cosine) * glass.tint.g;
        bare.r = dielectric_fresnel(etas.r, cosine) * glass.tint.r;
        bare.b = dielectric_fresnel(etas.b, cosine) * glass.tint.b;
    }
    if (!SCENE_IRIDESCENCE || glass.film.weight == 0.0) { return bare; }
    // A film reflects as much light from within as from the direction outside that it is refracted to.
    float outside = glass.eta < 1.0 ? safe_sqrt(1.0 - (1.0 - square(cosine)) / square(glass.eta)) : cosine;
    vec3 filmed = glass.film_share * film_fresnel(glass.film, glass.film_f0, outside);
    return mix(bare, filmed, glass.film.weight);
}

vec3 passing_color(Glass glass) {
    return SCENE_DISPERSION ? glass.color * glass.dispersed.transmitted_color : glass.color;
}

// The probability with which a microfacet reflects instead of refracting.
float glass_reflects(Glass glass, float cosine) {
    vec3 reflected = glass_fresnel(glass, cosine);
    float through = max_component((1.0 - reflected) * glass.color);
    return max_component(reflected) / max(max_component(reflected) + through, 1e-30);
}

// The albedo of single scattering with a film, for microfacets of these cosines; `ends` are those of the table. Where a
// film reflects more than the surface without it, this is a bound, so that no light is gained.
vec3 filmed_glass_albedo(Glass glass, vec2 ends, vec2 cosines) {
    vec3 filmed = vec3(1e-6);
    float bare = 1e-6;
    for (uint i = 0u; i < 2u; i++) {
        float without = dielectric_fresnel(glass.eta, cosines[i]);
        if (without < 1.0) {
            filmed += 0.5 * glass_fresnel(glass, cosines[i]);
            bare += 0.5 * without;
        }
    }
    vec3 albedo = mix(vec3(ends.x), vec3(ends.y), min(filmed / bare, 1.0));
    // From within, what is reflected is seldom scattered more than once.
    return glass.eta < 1.0 ? mix(albedo, vec3(1.0), max(filmed - bare, 0.0)) : albedo;
}

// `cosine` is that of the direction from which the surface is seen.
Glass prepare_glass(GlassParameters parameters, BaseMaterial base, float cosine) {
    bool mirror = base.roughness <= MIRROR_ROUGHNESS;
    // Where nothing is bent, a rough boundary would have no microfacet normals.
    float ior = mirror ? parameters.ior : max(parameters.ior, 1.005);
    Glass glass;
    glass.weight = SCENE_GLASS ? parameters.transmission * (1.0 - base.metallic) : 0.0;
    glass.eta = base.inside ? 1.0 / ior : ior;
    glass.dispersed = NOT_DISPERSED;
    if (SCENE_DISPERSION && parameters.dispersed.ior > 0.0) {
        float least = mirror ? 1.0 : 1.005;
        vec4 iors = max(vec4(parameters.dispersed.reflected_iors, parameters.dispersed.ior), least);
        vec4 etas = base.inside ? 1.0 / iors : iors;
        glass.dispersed = Dispersed(iors.w, etas.rgb, parameters.dispersed.transmitted_color);
        glass.eta = etas.w;
    }
    glass.thin = !base.solid;
    glass.roughness = base.roughness;
    glass.color = parameters.reflects_only ? vec3(0.0) : base.color;
    glass.tint = glass_tint(ior, base.specular_weight * reflectance_f0(base.reflectance));
    glass.film = base.film;
    glass.film_f0 = reflectance_f0(base.reflectance);
    glass.film_share = base.specular_weight;
    glass.compensation = vec3(1.0);
    if (glass.weight > 0.0 && !mirror) {
        vec2 ab = lookup_brdf_table(cosine, base.perceptual_roughness);
        vec3 albedo = vec3(ab.x + ab.y);
        if (!glass.thin) {
            vec2 ends = lookup_glass_table(glass.eta, cosine, base.perceptual_roughness);
            albedo = mix(vec3(ends.x), vec3(ends.y), glass.tint);
            if (SCENE_IRIDESCENCE && glass.film.weight > 0.0) {
                albedo = filmed_glass_albedo(glass, ends, film_cosines(glass.roughness, ab, cosine));
            }
        }
        glass.compensation = 1.0 / albedo;
    }
    return glass;
}

// The share of uniform incoming light that it reflects and lets pass, without `weight`.
vec3 glass_albedo(Glass glass, float cosine) { return mix(glass.color, vec3(1.0), glass_fresnel(glass, cosine)); }

// The direction in which a microfacet with normal m refracts wo; z is 0 for total internal reflection.
vec3 refract_through(Glass glass, vec3 wo, vec3 m) {
    float along = dot(wo, m);
    if (glass.thin) {
        vec3 reflected = 2.0 * along * m - wo;
        return vec3(reflected.xy, -reflected.z);
    }
    float cosine2 = 1.0 - (1.0 - square(along)) / square(glass.eta);
    if (!(cosine2 > 0.0)) { return vec3(0.0); }
    return normalize((along / glass.eta - sqrt(cosine2)) * m - wo / glass.eta);
}

// The microfacet normal that sends light from wo to wi; 0 when there is none.
vec3 glass_half_vector(Glass glass, vec3 wo, vec3 wi) {
    if (wi.z > 0.0 || glass.thin) { return normalize(vec3(wo.xy + wi.xy, wo.z + abs(wi.z))); }
    vec3 m = safe_normalize(wo + glass.eta * wi, vec3(0.0));
    m *= sign(m.z);
    return dot(wo, m) > 0.0 && dot(wi, m) < 0.0 ? m : vec3(0.0);
}

float smith_lambda(float roughness, vec3 w) {
    float tangent2 = dot(w.xy, w.xy) / max(square(w.z), 1e-30);
    return 0.5 * (sqrt(1.0 + square(roughness) * tangent2) - 1.0);
}

// The solid angle of wi per solid angle of the microfacet normal, inverted.
float glass_jacobian(Glass glass, vec3 wo, vec3 wi, vec3 m) {
    if (wi.z > 0.0 || glass.thin) { return 0.25 / max(dot(wo, m), 1e-30); }
    float sum = dot(wo, m) + glass.eta * dot(wi, m);
    return square(glass.eta) * -dot(wi, m) / max(square(sum), 1e-30);
}

// The density of microfacet normals as wo sees them, which sample_visible_normal samples.
float visible_normal_pdf(float roughness, vec3 wo, vec3 m) {
    return D_GGX(roughness, m) * max(dot(wo, m), 0.0) / (wo.z * (1.0 + smith_lambda(roughness, wo)));
}

float glass_pdf(Glass glass, vec3 wo, vec3 wi) {
    vec3 m = glass_half_vector(glass, wo, wi);
    float reflects = glass_reflects(glass, dot(wo, m));
    float chosen = wi.z > 0.0 ? reflects : 1.0 - reflects;
    float pdf = chosen * visible_normal_pdf(glass.roughness, wo, m) * glass_jacobian(glass, wo, wi, m);
    return m.z > 0.0 && wi.z != 0.0 ? pdf : 0.0;
}

// The lobe times the cosine of wi, without `weight`.
vec3 evaluate_glass(Glass glass, vec3 wo, vec3 wi) {
    vec3 m = glass_half_vector(glass, wo, wi);
    if (!(m.z > 0.0 && wi.z != 0.0)) { return vec3(0.0); }
    vec3 reflected = glass_fresnel(glass, dot(wo, m));
    float seen_by_both = 1.0 + smith_lambda(glass.roughness, wo) + smith_lambda(glass.roughness, wi);
    float shape = D_GGX(glass.roughness, m) * dot(wo, m) / (wo.z * seen_by_both) * glass_jacobian(glass, wo, wi, m);
    vec3 value = wi.z > 0.0 ? reflected : (1.0 - reflected) * passing_color(glass);
    return value * (shape * glass.compensation);
}

// A direction, and for smooth glass its weight. `choice` and u are uniform in [0, 1).
vec3 sample_glass(Glass glass, vec3 wo, float choice, vec2 u, out vec3 smooth_weight) {
    vec3 m = vec3(0.0, 0.0, 1.0);
    if (glass.roughness > MIRROR_ROUGHNESS) { m = sample_visible_normal(wo, vec2(glass.roughness), 1.0, u); }
    float reflects = glass_reflects(glass, dot(wo, m));
    vec3 reflected = glass_fresnel(glass, dot(wo, m));
    if (choice < reflects) {
        smooth_weight = reflected / reflects;
        vec3 wi = 2.0 * dot(wo, m) * m - wo;
        return wi.z > 0.0 ? wi : vec3(0.0);
    }
    smooth_weight = (1.0 - reflected) * passing_color(glass) / (1.0 - reflects);
    vec3 wi = refract_through(glass, wo, m);
    return wi.z < 0.0 ? wi : vec3(0.0);
}

// ---- as a row of scene/lobes/list.glsl ----------------------------------------------------------------

GlassParameters resolve_lobe(GlassParameters none, Material material, TexturePoint point) {
    return resolve_glass(material, point);
}

uint pack_lobe(GlassParameters glass, mat3 frame) { return pack_glass(glass); }
GlassParameters unpack_lobe(GlassParameters none, uint bits, mat3 frame) { return unpack_glass(bits); }

Glass prepare_lobe(GlassParameters parameters, BaseMaterial base, vec3 wo) {
    return prepare_glass(parameters, base, wo.z);
}

LobeAlbedo lobe_albedo(Glass glass, vec3 wo) { return LobeAlbedo(glass_albedo(glass, wo.z), glass.weight, false); }

LobeAlbedo lobe_albedo(GlassParameters parameters, BaseMaterial base, vec3 wo) {
    return lobe_albedo(prepare_glass(parameters, base, wo.z), wo);
}

bool is_mirror(Glass glass) { return glass.roughness <= MIRROR_ROUGHNESS; }

vec3 specular_value(Glass glass, vec3 wo, vec3 wi) {
    return glass.weight > 0.0 && !is_mirror(glass) ? glass.weight * evaluate_glass(glass, wo, wi) : vec3(0.0);
}

float lobe_pdf(Glass glass, vec3 wo, vec3 wi) { return is_mirror(glass) ? 0.0 : glass_pdf(glass, wo, wi); }

LobeSample sample_lobe(Glass glass, vec3 wo, float choice, vec2 u) {
    vec3 smooth_weight;
    vec3 wi = sample_glass(glass, wo, choice, u, smooth_weight);
    if (wi.z == 0.0) { return invalid_lobe_sample(); }
    return is_mirror(glass) ? mirrored_sample(wi, smooth_weight, glass.weight) : spread_sample(wi, false);
}

void leave_out(inout Glass glass) { glass.weight = 0.0; }

#endif
