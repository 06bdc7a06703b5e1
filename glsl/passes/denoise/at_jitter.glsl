// The denoised light at a pixel's sample. Histories average samples all over the pixel, so that their light is that of
// the pixel's center. It matters where pixels of the picture are smaller: there the light's slope is taken from the
// neighbors whose surfaces are alike, of which there may be one alone.
#ifndef PASSES_DENOISE_AT_JITTER_GLSL
#define PASSES_DENOISE_AT_JITTER_GLSL

#include "common/pixel.glsl"
#include "passes/denoise/edge_stopping.glsl"
#include "passes/denoise/signal.glsl"

Signals load_filtered(uint index) { return unpack_signals(denoise_pong.at[index].xyz); }

// Adds the light's slope along an axis times the distance from the pixel's center. below, above: the pixels on both
// sides, with their weights.
void add_slope(inout vec3 sum, Signal own, Signal below, Signal above, vec2 weights, float distance) {
    weights *= vec2(below.standard_error >= 0.0, above.standard_error >= 0.0);
    vec3 slope = weights.x * (own.radiance - below.radiance) + weights.y * (above.radiance - own.radiance);
    sum += own.standard_error >= 0.0 ? slope * distance / max(weights.x + weights.y, 1.0) : vec3(0.0);
}

void denoised_at_jitter(ivec2 pixel, out Signal diffuse, out Signal specular) {
    Signals own = load_filtered(element_index(pixel, camera.size));
    diffuse = own.diffuse;
    specular = own.specular;
    if (camera.size == camera.picture_size) { return; }
    EdgeStopping edges = make_edge_stopping(load_guide(pixel), pixel, 0.0, MIN_ALPHA_CERTAIN);
    ivec2 last = ivec2(camera.size) - 1;
    for (int axis = 0; axis < 2; axis++) {
        Signals found[2];
        mat2 weights;  // by the side and the lobe
        for (int side = 0; side < 2; side++) {
            ivec2 step = (2 * side - 1) * ivec2(1 - axis, axis), other = clamp(pixel + step, ivec2(0), last);
            uint at = element_index(other, camera.size);
            weights[side] = other == pixel + step
                ? edge_stopping_weights(edges, denoise_guides.at[at], step)
                : vec2(0.0);
            found[side] = load_filtered(at);
        }
        weights = transpose(weights);
        float distance = this_frame.sample_offset[axis];
        add_slope(diffuse.radiance, own.diffuse, found[0].diffuse, found[1].diffuse, weights[0], distance);
        add_slope(specular.radiance, own.specular, found[0].specular, found[1].specular, weights[1], distance);
    }
    diffuse.radiance = max(diffuse.radiance, vec3(0.0));
    specular.radiance = max(specular.radiance, vec3(0.0));
}

#endif
