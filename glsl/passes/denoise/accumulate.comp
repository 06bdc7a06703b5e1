// Adds each pixel's light to its mean over frames, whose length changes of light shorten.
#version 460
#include "passes/denoise/cell.glsl"
#include "passes/denoise/sample.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const float SMOOTH = 0.4;  // perceptual roughness
const float BOX = 2.0;  // half width, in standard deviations
const uint PASS_SALT = 0x54FF53A5u;

Lobe add_sample(Lobe past, vec4 found, float confidence) {
    if (!is_valid(found.rgb)) { return past; }
    float value = luminance(found.rgb);
    past.frames = min(past.frames * confidence, float(denoise_settings.frames - 1u));
    float weight = 1.0 / (past.frames + 1.0);
    float inverse = found.w > 0.0 ? 1.0 / found.w : past.inverse_distance;
    return Lobe(
        mix(past.radiance, found.rgb, weight), mix(past.second_moment, value * value, weight),
        mix(past.recent, value, max(weight, RECENT)), past.frames + 1.0,
        past.inverse_distance > 0.0 ? mix(past.inverse_distance, inverse, weight) : inverse
    );
}

// While the camera moves, the history of a smooth curved surface may have come from beside the reflection that it shows
// now. What such surfaces reflect has little noise, so that this frame's samples around tell what the history can be.
Lobe limited(Lobe past, ivec2 pixel) {
    vec2 sums = vec2(0.0);
    float count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 other = clamp(pixel + ivec2(i % 3, i / 3) - 1, ivec2(0), ivec2(camera.size) - 1);
        uint at = uint(other.y) * camera.size.x + uint(other.x);
        if (kind_of(denoise_guides.at[at]) != SURFACE_SHOWN) { continue; }
        float value = luminance(specular_sample(at, other, SURFACE_SHOWN).rgb);
        sums += vec2(value, value * value);
        count += 1.0;
    }
    float mean = sums.x / count, deviation = sqrt(max(sums.y / count - mean * mean, 0.0));
    float own = luminance(past.radiance);
    float inside = clamp(own, mean - BOX * deviation, mean + BOX * deviation);
    float scale = own > 0.0 ? inside / own : 1.0;
    past.radiance *= scale;
    past.second_moment *= scale * scale;
    past.recent *= scale;
    past.frames *= 1.0 - min(abs(own - inside) / max(max(own, inside), 1e-30), 1.0);
    return past;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (denoise_settings.denoise == 0u || any(greaterThanEqual(pixel, ivec2(camera.size)))) { return; }
    uint index = uint(pixel.y) * camera.size.x + uint(pixel.x), kind = kind_of(denoise_guides.at[index]);
    if (kind == NOTHING_SHOWN) { return; }
    vec2 confidence = denoise_blocks.at[cell_at(pixel)].confidence;
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ PASS_SALT);
    Lobe diffuse = add_sample(unpack_lobe(denoise_diffuse.at[index]), diffuse_sample(index), confidence.x);
    vec4 by_specular = specular_sample(index, pixel, kind);
    Lobe past = unpack_lobe(denoise_specular.at[index]);
    bool moves = camera.world_from_view != previous_camera.world_from_view;
    if (moves && kind == SURFACE_SHOWN && load_guide(pixel).material < SMOOTH) { past = limited(past, pixel); }
    Lobe specular = add_sample(past, by_specular, confidence.y);
    denoise_diffuse.at[index] = pack_lobe(diffuse, rng);
    denoise_specular.at[index] = pack_lobe(specular, rng);
}
