// Adds each pixel's light to its mean over frames, whose length changes of light shorten.
#version 460
#include "passes/denoise/cell.glsl"
#include "passes/denoise/sample.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const float SMOOTH = 0.4;  // perceptual roughness
const vec2 UNLIKE = vec2(2.0, 3.5);  // standard errors between which a history is no longer that of the reflection
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
// now. Returns the share of it that this frame's samples around leave valid, by Student's t of their mean difference.
float registered_share(Lobe past, ivec2 pixel) {
    float own = luminance(past.radiance), total = 0.0, squares = 0.0, count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 other = clamp(pixel + ivec2(i % 3, i / 3) - 1, ivec2(0), ivec2(camera.size) - 1);
        uint at = uint(other.y) * camera.size.x + uint(other.x);
        vec3 radiance = specular_sample(at, other, SURFACE_SHOWN).rgb;
        if (kind_of(denoise_guides.at[at]) != SURFACE_SHOWN || !is_valid(radiance)) { continue; }
        float difference = luminance(radiance) - own;
        total += difference;
        squares += difference * difference;
        count += 1.0;
    }
    if (total == 0.0) { return 1.0; }
    // The history's variance counts too, since few samples may show none of the rare bright ones.
    float variance = max(squares / count - square(total / count), past.second_moment - own * own);
    return 1.0 - smoothstep(UNLIKE.x, UNLIKE.y, abs(total) / sqrt(count * max(variance, 1e-30)));
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
    if (moves && kind == SURFACE_SHOWN && load_guide(pixel).material < SMOOTH) {
        past.frames *= registered_share(past, pixel);
    }
    Lobe specular = add_sample(past, by_specular, confidence.y);
    denoise_diffuse.at[index] = pack_lobe(diffuse, rng);
    denoise_specular.at[index] = pack_lobe(specular, rng);
}
