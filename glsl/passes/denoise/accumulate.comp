// Adds each pixel's light to its mean over frames, whose length changes of light shorten.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/aside.glsl"
#include "passes/denoise/cell.glsl"
#include "passes/denoise/sample.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x54FF53A5u;

Lobe add_sample(Lobe past, vec4 found, float confidence) {
    if (!is_valid(found.rgb)) { return past; }
    float value = luminance(found.rgb);
    past.frames = min(past.frames * confidence, float(denoise_settings.frames - 1u));
    float weight = 1.0 / (past.frames + 1.0);
    float inverse = found.w > 0.0 ? max(1.0 / found.w, INVERSE_OF_INFINITY) : past.inverse_distance;
    return Lobe(
        mix(past.radiance, found.rgb, weight), mix(past.second_moment, value * value, weight),
        mix(past.recent, value, max(weight, RECENT)), past.frames + 1.0,
        past.inverse_distance > 0.0 ? mix(past.inverse_distance, inverse, weight) : inverse
    );
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (denoise_settings.denoise == 0u || !is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size), kind = kind_of(denoise_guides.at[index]);
    vec2 confidence = denoise_blocks.at[cell_at(pixel)].confidence;
    if (min(confidence.x, confidence.y) < 1.0) { shorten_aside(index, min(confidence.x, confidence.y)); }
    if (kind == NOTHING_SHOWN) { return; }
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ PASS_SALT);
    Lobe diffuse = add_sample(unpack_lobe(denoise_diffuse.at[index]), diffuse_sample(index), confidence.x);
    vec4 by_specular = specular_sample(index, pixel, kind);
    Lobe specular = add_sample(unpack_lobe(denoise_specular.at[index]), by_specular, confidence.y);
    denoise_diffuse.at[index] = pack_lobe(diffuse, rng);
    denoise_specular.at[index] = pack_lobe(specular, rng);
}
