// What other stages may ask the denoiser: it alone knows how its buffers are packed.
#ifndef PASSES_DENOISE_API_GLSL
#define PASSES_DENOISE_API_GLSL

#include "passes/denoise/at_jitter.glsl"
#include "passes/denoise/removed_light.glsl"

struct Denoised {
    vec3 diffuse;  // demodulated, as all light of the denoiser
    vec3 specular;
    vec3 psr_albedo;  // of primary surface replacement, by which the specular light is demodulated too; else 1
    vec2 deviations;  // standard deviations of the noise that is left in the luminances of both lobes
};

// Whether a pixel is denoised: the denoiser is on, and what the pixel shows has noise.
bool uses_denoiser(uint index) {
    return denoise_settings.denoise != 0u && kind_of(denoise_guides.at[index]) != NOT_DENOISED;
}

// The history lengths of the diffuse and the specular lobe: with this frame once denoise/accumulate has run.
float history_length(uint index) { return unpack_lobe_history(denoise_diffuse.at[index]).frames; }
float specular_history_length(uint index) { return unpack_lobe_history(denoise_specular.at[index]).frames; }

// The standard error of the diffuse lobe's mean over frames, over that mean.
float history_relative_error(uint index) {
    LobeHistory lobe = unpack_lobe_history(denoise_diffuse.at[index]);
    float mean = luminance(lobe.radiance), variance = max(lobe.second_moment - mean * mean, 0.0);
    return mean > 0.0 ? sqrt(variance / max(lobe.frames, 1.0)) / mean : 0.0;
}

// The estimated error of a pixel's luminance, remodulated by these albedos: of noise and of the blur's bias.
float standard_error(Denoised light, uint index, vec3 diffuse_albedo, vec3 specular_albedo) {
    LobeHistory diffuse = unpack_lobe_history(denoise_diffuse.at[index]);
    LobeHistory specular = unpack_lobe_history(denoise_specular.at[index]);
    vec2 frames = max(vec2(effective_frames(diffuse), effective_frames(specular)), MIN_FRAMES_OF_BIAS);
    vec2 error_over_noise = ERROR_OVER_NOISE + BIAS_OVER_NOISE * inversesqrt(frames);
    return length(error_over_noise * light.deviations * vec2(luminance(diffuse_albedo), luminance(specular_albedo)));
}

// The light of a pixel that is denoised, after all passes of the denoiser.
Denoised denoised(uvec2 pixel) {
    Signal diffuse, specular;
    denoised_at_jitter(ivec2(pixel), diffuse, specular);
    uint kind = kind_of(denoise_guides.at[element_index(pixel, camera.size)]);
    vec2 deviations = max(vec2(diffuse.standard_error, specular.standard_error), 0.0);
    vec2 gains = gains_at(pixel);
    // Nobody knows where the light of fireflies belongs, so all that a pixel gets of it counts as error too.
    vec2 gained = gains * vec2(luminance(diffuse.radiance), luminance(specular.radiance));
    deviations = sqrt(deviations * deviations + gained * gained);
    return Denoised(
        (1.0 + gains.x) * diffuse.radiance, (1.0 + gains.y) * specular.radiance, psr_albedo(ivec2(pixel), kind),
        deviations
    );
}

#endif
