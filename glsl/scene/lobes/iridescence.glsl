// Iridescence: a thin film over a metal or a dielectric, whose two interfaces reflect light that interferes. Belcour
// and Barla, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence" (2017), with
// Schlick's approximation at both interfaces, as KHR_materials_iridescence has it.
#ifndef SCENE_LOBES_IRIDESCENCE_GLSL
#define SCENE_LOBES_IRIDESCENCE_GLSL

#include "common/packing.glsl"
#include "scene/bindings.glsl"
#include "scene/brdf_table.glsl"
#include "scene/microfacet.glsl"

// ---- of a material ----------------------------------------------------------------------------------

struct ThinFilm {
    float weight;
    float ior;
    float thickness;  // nanometers
};

const ThinFilm NO_FILM = ThinFilm(0.0, 1.0, 0.0);
const float LARGEST_FILM_RATIO = 0.75;  // (ior - 1) / (ior + 1) for an index of refraction of 7
const float LARGEST_PACKED_FILM = 8192.0;  // nanometers; thicker films have no colors

// weight 8, index of refraction 10, thickness 14
uint pack_film(ThinFilm film) {
    float ratio = (film.ior - 1.0) / (film.ior + 1.0) / LARGEST_FILM_RATIO;
    return pack_unorm(film.weight, 8u) | pack_unorm(ratio, 10u) << 8u
        | pack_unorm(film.thickness / LARGEST_PACKED_FILM, 14u) << 18u;
}

ThinFilm unpack_film(uint bits) {
    float ratio = LARGEST_FILM_RATIO * unpack_unorm(bits >> 8u, 10u);
    float thickness = LARGEST_PACKED_FILM * unpack_unorm(bits >> 18u, 14u);
    return ThinFilm(unpack_unorm(bits, 8u), (1.0 + ratio) / (1.0 - ratio), thickness);
}

// ---- reflectance ------------------------------------------------------------------------------------

// The color, in linear Rec. 709, of light whose waves are out of step by a path of so many nanometers and by a shift of
// phase, one for each of X, Y and Z: the Fourier transforms of Gaussians that stand for the color matching functions.
vec3 film_sensitivity(float path, vec3 shift) {
    const mat3 rgb_of_xyz = mat3(
        3.2404542, -0.9692660, 0.0556434, -1.5371385, 1.8760108, -0.2040259, -0.4985314, 0.0415560, 1.0572252
    );
    const vec4 area = vec4(5.4856e-13, 4.4201e-13, 5.2481e-13, 9.7470e-14) / 1.0685e-7;
    const vec4 position = vec4(1.6810e6, 1.7953e6, 2.2084e6, 2.2399e6);
    const vec4 variance = vec4(4.3278e9, 9.3046e9, 6.6121e9, 4.5282e9);  // X has two Gaussians
    float phase = 2.0e-9 * PI * path;
    vec4 waves = area * sqrt(2.0 * PI * variance) * cos(position * phase + shift.xyzx)
        * exp(-square(phase) * variance);
    return rgb_of_xyz * vec3(waves.x + waves.w, waves.yz);
}

// The reflectance of a film over a surface that reflects f0 without it. It is at most 1: colors outside Rec. 709 are
// clamped.
vec3 film_fresnel(ThinFilm film, vec3 f0, float cosine) {
    float ior = film.ior;
    float cosine2 = 1.0 - (1.0 - square(cosine)) / square(ior);
    if (!(cosine2 > 0.0)) { return vec3(1.0); }
    cosine2 = sqrt(cosine2);
    vec3 bare = fresnel(f0, cosine);
    float upper = fresnel(vec3(square((ior - 1.0) / (ior + 1.0))), cosine).x;
    vec3 root = sqrt(min(f0, 0.9999));
    vec3 base_ior = (1.0 + root) / (1.0 - root);
    vec3 amplitude = (base_ior - ior) / (base_ior + ior);
    vec3 lower = fresnel(amplitude * amplitude, cosine2);
    vec3 shift = PI + mix(vec3(0.0), vec3(PI), lessThan(base_ior, vec3(ior)));
    float through = 1.0 - upper;
    vec3 both = upper * lower;
    vec3 incoherent = square(through) * lower / (1.0 - both);
    vec3 reflected = upper + incoherent;
    vec3 wave = incoherent - through;
    for (float m = 1.0; m <= 2.0; m++) {
        wave *= sqrt(both);
        reflected += 2.0 * wave * film_sensitivity(m * 2.0 * ior * film.thickness * cosine2, m * shift);
    }
    return mix(bare, clamp(reflected, 0.0, 1.0), smoothstep(0.0, 0.03, film.thickness));
}

// ---- albedo -----------------------------------------------------------------------------------------

// Two cosines x that stand for the microfacets that a direction sees, from A and B of their albedo there. They have
// the microfacets' mean of (1 - x)^5, so that a mean over them is exact for Schlick's Fresnel and for mirrors; that of
// films is off by 0.01 in the mean, and by 0.1 at most.
vec2 film_cosines(float roughness, vec2 ab, float cosine) {
    float middle = pow(max(ab.y, 1e-30) / (ab.x + ab.y), 0.2);
    float spread = 0.8 * roughness * safe_sqrt(1.0 - square(cosine)) / max(middle, 1e-3);
    float near = clamp(1.0 - spread, 0.4, 1.0);
    return max(1.0 - middle * vec2(near, pow(2.0 - pow(near, 5.0), 0.2)), 0.0);
}

// The mean of film_fresnel over the microfacets that a direction sees.
vec3 mean_film_fresnel(ThinFilm film, vec3 f0, float roughness, vec2 ab, float cosine) {
    vec2 cosines = film_cosines(roughness, ab, cosine);
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < 2u; i++) { sum += film_fresnel(film, f0, cosines[i]); }
    return 0.5 * sum;
}

// The directional albedo of a lobe with this mean Fresnel reflectance, with multiple scattering.
vec3 film_albedo(vec3 mean, vec2 ab) { return mean * mix(vec3(ab.x + ab.y), vec3(1.0), mean); }

// What a film over a dielectric keeps from the lobes below: the largest of three colors, as glTF has it, which
// changes no hue. `average` and `margin` are the same for all directions.
struct FilmCover {
    float average;  // the mean over directions, weighted by their cosines
    float margin;   // by which the cover of a direction is raised, so that no energy is gained
};

FilmCover prepare_film_cover(ThinFilm film, vec3 f0, float roughness, float perceptual_roughness) {
    const vec4 cosines = vec4(0.2634993, 0.5744640, 0.8185295, 0.9646597);  // Gauss's points of their squares
    const vec4 weights = vec4(0.1739274, 0.3260726, 0.3260726, 0.1739274);
    float sum = 0.0;
    vec3 least = vec3(1.0), largest = vec3(0.0);
    for (uint i = 0u; i < 4u; i++) {
        vec3 reflected = film_fresnel(film, f0, cosines[i]);
        float grazing = fresnel(vec3(0.0), cosines[i]).x;
        vec3 color = (reflected - grazing) / (1.0 - grazing);  // as F0 of Schlick's Fresnel
        sum += weights[i] * max_component(reflected);
        least = min(least, color);
        largest = max(largest, color);
    }
    // The F0 with whose Fresnel a mirror has the same mean.
    float as_f0 = saturate((21.0 * sum - 1.0) / 20.0);
    mat3 averages = lookup_brdf_averages(perceptual_roughness);
    float average = averages[0].x + as_f0 * (averages[1].x + as_f0 * averages[2].x);
    return FilmCover(average, 0.05 * max_component(largest - least) * min(sqrt(roughness) / 0.3, 1.0));
}

float film_cover(FilmCover cover, vec3 mean, vec2 ab) {
    return min(max_component(film_albedo(mean, ab)) + cover.margin, 1.0);
}

#endif
