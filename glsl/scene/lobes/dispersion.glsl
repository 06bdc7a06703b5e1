// Dispersion, as in KHR_materials_dispersion. A path carries all wavelengths until it is refracted into dispersive
// glass, and a single one from there on (TerminateSecondary in pbrt), weighted by what red, green and blue see of it.
#ifndef SCENE_LOBES_DISPERSION_GLSL
#define SCENE_LOBES_DISPERSION_GLSL

#include "common/math.glsl"

// Red, green and blue each see light around a wavelength, in nanometers, less in proportion to the distance, up to
// BAND_WIDTH. The wavelengths are those of the positive parts of Rec. 709's color matching functions.
const vec3 BANDS = vec3(610.0, 540.0, 450.0);
const float BAND_WIDTH = 70.0;
const float ALL_WAVELENGTHS = 0.0;

// The response of red, green and blue to a wavelength, over the pdf of sample_wavelength: 1 in the mean.
vec3 wavelength_color(float wavelength) {
    vec3 bands = max(BAND_WIDTH - abs(wavelength - BANDS), 0.0);
    return 3.0 * bands / max(bands.r + bands.g + bands.b, 1e-3);
}

// One of the bands, and a wavelength in it. u is uniform in [0, 1).
float sample_wavelength(float u) {
    uint band = min(uint(3.0 * u), 2u);
    float side = 2.0 * (3.0 * u - float(band)) - 1.0;
    return BANDS[band] + BAND_WIDTH * sign(side) * (1.0 - sqrt(saturate(1.0 - abs(side))));
}

// The index of refraction by Cauchy's equation, from that at 587.6 nm and `dispersion`, which is 20 over the Abbe
// number. `inverse_square` is one over the square of the wavelength, or its mean over waves.
vec3 dispersed_ior(float ior, float dispersion, vec3 inverse_square) {
    return max(ior + (ior - 1.0) * dispersion / 20.0 * (523655.0 * inverse_square - 1.5168), 1.0);
}

// The means of one over the square of the wavelength in each band.
vec3 bands_inverse_square() { return -log(1.0 - square(BAND_WIDTH) / (BANDS * BANDS)) / square(BAND_WIDTH); }

// What a material's dispersion makes of it for a path.
struct Dispersed {
    float ior;               // for the path's wavelength; 0: without dispersion
    vec3 reflected_iors;     // for reflection of red, green and blue
    vec3 transmitted_color;  // factor of transmitted light; 1 if the path had one wavelength already
};

const Dispersed NOT_DISPERSED = Dispersed(0.0, vec3(0.0), vec3(1.0));

#endif
