// The denoised light at a pixel's sample. Histories average samples all over the pixel, so that their light is that of
// the pixel's center. It matters where pixels of the picture are smaller.
#ifndef PASSES_DENOISE_AT_SAMPLE_GLSL
#define PASSES_DENOISE_AT_SAMPLE_GLSL

#include "passes/denoise/likeness.glsl"
#include "passes/denoise/lobe.glsl"

void add_weighted(inout Signal sum, inout float total, Signal found, float weight) {
    if (found.variance < 0.0) { return; }
    sum.radiance += weight * found.radiance;
    sum.variance += weight * found.variance;
    total += weight;
}

// Bilinear interpolation between the centers of pixels whose surfaces are alike.
void light_at_sample(ivec2 pixel, out Signal diffuse, out Signal specular) {
    vec2 offset = camera.size == camera.picture_size ? vec2(0.0) : this_frame.sample_offset;
    Pattern pattern = make_pattern(load_guide(pixel), 0.0);
    diffuse = specular = Signal(vec3(0.0), 0.0);
    vec2 totals = vec2(0.0);
    for (int i = 0; i < 4; i++) {
        ivec2 taken = ivec2(i & 1, i >> 1), step = taken * ivec2(sign(offset)), other = pixel + step;
        vec2 share = mix(1.0 - abs(offset), abs(offset), vec2(taken)), weights = vec2(share.x * share.y);
        if (any(lessThan(other, ivec2(0))) || any(greaterThanEqual(other, ivec2(camera.size)))) { continue; }
        uint at = uint(other.y) * camera.size.x + uint(other.x);
        if (i > 0) { weights *= likeness(pattern, denoise_guides.at[at], step); }
        if (max(weights.x, weights.y) == 0.0) { continue; }
        uvec4 bits = denoise_odd.at[at];
        add_weighted(diffuse, totals.x, unpack_signal(bits.xy), weights.x);
        add_weighted(specular, totals.y, unpack_signal(bits.zw), weights.y);
    }
    vec2 scale = 1.0 / max(totals, vec2(1e-9));
    diffuse = Signal(scale.x * diffuse.radiance, scale.x * diffuse.variance);
    specular = Signal(scale.y * specular.radiance, scale.y * specular.variance);
}

#endif
