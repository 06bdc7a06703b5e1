// The denoised light at a pixel's sample. Histories average samples all over the pixel, so that their light is that of
// the pixel's center. It matters where pixels of the picture are smaller.
#ifndef PASSES_DENOISE_AT_SAMPLE_GLSL
#define PASSES_DENOISE_AT_SAMPLE_GLSL

#include "passes/denoise/likeness.glsl"
#include "passes/denoise/signal.glsl"

void add_weighted(inout Signal sum, inout float total, Signal found, float weight) {
    if (found.deviation < 0.0) { return; }
    sum.radiance += weight * found.radiance;
    sum.deviation += weight * found.deviation;
    total += weight;
}

Signals load_filtered(uint index) { return unpack_signals(denoise_odd.at[index].xyz); }

// Bilinear interpolation between the centers of pixels whose surfaces are alike.
void light_at_sample(ivec2 pixel, out Signal diffuse, out Signal specular) {
    if (camera.size == camera.picture_size) {
        Signals found = load_filtered(uint(pixel.y) * camera.size.x + uint(pixel.x));
        diffuse = found.diffuse;
        specular = found.specular;
        return;
    }
    vec2 offset = this_frame.sample_offset;
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
        Signals found = load_filtered(at);
        add_weighted(diffuse, totals.x, found.diffuse, weights.x);
        add_weighted(specular, totals.y, found.specular, weights.y);
    }
    vec2 scale = 1.0 / max(totals, vec2(1e-9));
    diffuse = Signal(scale.x * diffuse.radiance, scale.x * diffuse.deviation);
    specular = Signal(scale.y * specular.radiance, scale.y * specular.deviation);
}

#endif
