// Multiplies the light of paths, denoised or not, by the surfaces' colors again, and adds visible emission.
#version 460
#include "passes/denoise/at_sample.glsl"
#include "passes/display/emission.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/paths/demodulation.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The error over the deviation of the noise that is left, since the blur has an error of its own: chosen so that
// about 68 % of the pixels of mirror_hall and other scenes are within one standard error (docs/denoising.md).
const float ERROR_OVER_NOISE = 1.38;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    uint index = pixel.y * camera.size.x + pixel.x;
    GBufferSurface surface = load_gbuffer(pixel);
    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    Demodulation by;
    if (surface.exists) {
        by = demodulation(surface);
        diffuse = paths_diffuse.at[index].rgb * by.diffuse;
        specular = paths_specular.at[index].rgb * by.specular;
    }
    vec3 emitted = visible_emission(pixel);
    raw_radiance.at[index] = emitted + diffuse + specular;
    error.at[index] = 0.0;
    uint kind = kind_of(denoise_guides.at[index]);
    if (denoise_settings.denoise != 0u && kind != NOTHING_SHOWN) {
        Signal by_diffuse, by_specular;
        light_at_sample(ivec2(pixel), by_diffuse, by_specular);
        by.specular *= reflected_albedo(ivec2(pixel), kind);
        diffuse = by_diffuse.radiance * by.diffuse;
        specular = by_specular.radiance * by.specular;
        vec2 deviations = max(vec2(by_diffuse.deviation, by_specular.deviation), 0.0);
        error.at[index] = ERROR_OVER_NOISE * length(deviations * vec2(luminance(by.diffuse), luminance(by.specular)));
    }
    emission.at[index] = emitted;
    diffuse_radiance.at[index] = diffuse;
    specular_radiance.at[index] = specular;
    sample_radiance.at[index] = emitted + diffuse + specular;
}
