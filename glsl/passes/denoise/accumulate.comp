// Adds this frame's light of each pixel to the pixel's mean over frames. Where light has changed, the history length is
// first multiplied by the history's confidence, so that the new light replaces the old sooner. Pixels without a path in
// this frame keep their means.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/alternate_history.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/denoise/noisy_input.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x54FF53A5u;

LobeHistory add_sample(LobeHistory history, vec4 radiance_hit_distance, float confidence) {
    if (!is_finite_color(radiance_hit_distance.rgb)) { return history; }
    float value = luminance(radiance_hit_distance.rgb);
    history.frames = min(history.frames * confidence, float(denoise_settings.max_history - 1u));
    if (has_no_path(radiance_hit_distance)) { return history; }
    float weight = 1.0 / (history.frames + 1.0);
    float inverse = radiance_hit_distance.w > 0.0
        ? max(1.0 / radiance_hit_distance.w, MIN_INVERSE_HIT_DISTANCE)
        : history.inverse_hit_distance;
    return LobeHistory(
        mix(history.radiance, radiance_hit_distance.rgb, weight), mix(history.second_moment, value * value, weight),
        mix(history.fast_luminance, value, max(weight, FAST_WEIGHT)), history.frames + 1.0,
        history.inverse_hit_distance > 0.0 ? mix(history.inverse_hit_distance, inverse, weight) : inverse
    );
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy;
    uint index;
    if (denoise_settings.denoise == 0u || !find_pixel(found, index)) { return; }
    ivec2 pixel = ivec2(found);
    uint kind = kind_of(denoise_guides.at[index]);
    vec2 confidence = denoise_neighborhoods.at[cell_at(pixel)].confidence;
    if (min(confidence.x, confidence.y) < 1.0) { shorten_alternate(index, min(confidence.x, confidence.y)); }
    if (kind == NOT_DENOISED) { return; }
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ PASS_SALT);
    LobeHistory diffuse = add_sample(unpack_lobe_history(denoise_diffuse.at[index]), noisy_diffuse(index),
        confidence.x);
    vec4 specular_value = noisy_specular(index, pixel, kind);
    LobeHistory specular = add_sample(unpack_lobe_history(denoise_specular.at[index]), specular_value, confidence.y);
    denoise_diffuse.at[index] = pack_lobe_history(diffuse, rng);
    denoise_specular.at[index] = pack_lobe_history(specular, rng);
}
