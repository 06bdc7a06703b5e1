// The denoised light at the jittered position of this frame's sample. Histories average samples from all over a pixel,
// so that denoised light is that of its center. In upscaled pictures the difference shows, since several output pixels
// lie in one rendered pixel. So the light is extrapolated to the sample by its spatial gradient,
// from the neighbors on both sides, or on one side where only that neighbor shows a similar surface.
#ifndef PASSES_DENOISE_AT_JITTER_GLSL
#define PASSES_DENOISE_AT_JITTER_GLSL

#include "common/pixel.glsl"
#include "passes/denoise/edge_stopping.glsl"
#include "passes/denoise/signal.glsl"

// The blur has an odd number of passes, so that the last one writes denoise_pong.
Signals load_filtered(uint index) { return unpack_signals(denoise_pong.at[index].xyz); }

// Adds the first-order term of light along an axis: its spatial gradient times the distance from the pixel's center.
// below, above: the pixels on both sides, with their edge-stopping weights.
void add_first_order_term(
    inout vec3 sum, Signal own, Signal below, Signal above, vec2 weights, float distance
) {
    weights *= vec2(below.standard_error >= 0.0, above.standard_error >= 0.0);
    vec3 gradient = weights.x * (own.radiance - below.radiance) + weights.y * (above.radiance - own.radiance);
    sum += own.standard_error >= 0.0 ? gradient * distance / max(weights.x + weights.y, 1.0) : vec3(0.0);
}

void denoised_at_jitter(ivec2 pixel, out Signal diffuse, out Signal specular) {
    Signals own = load_filtered(element_index(pixel, camera.size));
    diffuse = own.diffuse;
    specular = own.specular;
    if (camera.size == camera.picture_size) { return; }
    EdgeStopping edges = make_edge_stopping(load_guide(pixel), pixel, 0.0, MIN_ALPHA_CONVERGED);
    ivec2 last = ivec2(camera.size) - 1;
    for (int axis = 0; axis < 2; axis++) {
        Signals found[2];
        mat2 weights;  // [side][lobe], until it is transposed below
        for (int side = 0; side < 2; side++) {
            ivec2 step = (2 * side - 1) * ivec2(1 - axis, axis), other = clamp(pixel + step, ivec2(0), last);
            uint other_index = element_index(other, camera.size);
            weights[side] = other == pixel + step
                ? edge_stopping_weights(edges, denoise_guides.at[other_index], step)
                : vec2(0.0);
            found[side] = load_filtered(other_index);
        }
        weights = transpose(weights);
        float distance = this_frame.sample_jitter[axis];
        add_first_order_term(
            diffuse.radiance, own.diffuse, found[0].diffuse, found[1].diffuse, weights[0], distance
        );
        add_first_order_term(
            specular.radiance, own.specular, found[0].specular, found[1].specular, weights[1], distance
        );
    }
    diffuse.radiance = max(diffuse.radiance, vec3(0.0));
    specular.radiance = max(specular.radiance, vec3(0.0));
}

#endif
