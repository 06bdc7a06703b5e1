// Prepares the input of the blur: the mean light of each lobe over frames, and the standard error of that mean, from
// the temporal variance and from the spatial variance of 3 x 3 pixels (SVGF). Both are taken about the mean of the 3 x
// 3 pixels, so that a pixel that is far from its neighbors gets a large error: in few frames it is most often noise.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/denoise/edge_stopping.glsl"
#include "passes/denoise/signal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The width of blocks of pixels of which one takes a path in a frame.
layout(constant_id = block_width_id) const int block_width = 1;

const uint PASS_SALT = 0xBB67AE85u;

struct Moments {
    float weight_sum;
    float luminance_sum;
    float squared_luminance_sum;
};

void add_moments(inout Moments sum, LobeHistory lobe, float weight) {
    if (lobe.frames == 0.0) { weight = 0.0; }
    sum.weight_sum += weight;
    sum.luminance_sum += weight * luminance(lobe.radiance);
    sum.squared_luminance_sum += weight * lobe.second_moment;
}

// Bounds of the specular luminances around a pixel: each lies between its mean minus and plus its standard error.
struct LuminanceBounds {
    float max_lower_bound;  // how bright the brightest neighbor is at least
    float min_upper_bound;  // how bright the darkest neighbor is at most
};

void add_bounds(inout LuminanceBounds bounds, LobeHistory lobe) {
    if (lobe.frames == 0.0) { return; }
    float mean = luminance(lobe.radiance);
    float deviation = sqrt(max(lobe.second_moment - mean * mean, 0.0) / lobe.frames);
    bounds.max_lower_bound = max(bounds.max_lower_bound, mean - deviation);
    bounds.min_upper_bound = min(bounds.min_upper_bound, mean + deviation);
}

// The pixel's mean light and its standard error. Clamps fireflies: pixels that are far brighter than their neighbors
// and the 3 x 3 gradient cells around, with a short history or with light that few frames brought. Where all around is
// black or no neighbor shows a similar surface nothing is clamped: the pixel may show a small object. The history isn't
// clamped, so that the light is shown as soon as more frames bring it.
Signal estimate_signal(LobeHistory lobe, Moments sum, float trimmed_mean_luminance) {
    if (lobe.frames == 0.0) { return Signal(vec3(0.0), -1.0); }
    float local_mean = sum.luminance_sum / sum.weight_sum, value = luminance(lobe.radiance);
    float neighbor_weight = sum.weight_sum - CENTER_MOMENTS_WEIGHT;
    float neighbor_mean = max(sum.luminance_sum - CENTER_MOMENTS_WEIGHT * value, 0.0)
        / max(neighbor_weight, MIN_NEIGHBOR_WEIGHT);
    float long_history = min(FIREFLY_FRAMES, float(denoise_settings.max_history));
    float effective = effective_frames(lobe);
    float firefly_tolerance = min(effective * effective, lobe.frames);
    bool is_reliable = lobe.frames >= long_history
        && effective >= min(MIN_EFFECTIVE_FRAMES, MIN_EFFECTIVE_SHARE * lobe.frames);
    float limit = max(MAX_OVER_NEIGHBORS * neighbor_mean, MAX_OVER_CELLS * firefly_tolerance * trimmed_mean_luminance);
    if (value > limit && limit > 0.0 && neighbor_weight > MIN_NEIGHBOR_WEIGHT && !is_reliable) {
        lobe.radiance *= limit / value;
        lobe.second_moment *= square(limit / value);
        local_mean += CENTER_MOMENTS_WEIGHT * (limit - value) / sum.weight_sum;
        value = limit;
    }
    float spatial_variance = max(sum.squared_luminance_sum / sum.weight_sum - local_mean * local_mean, 0.0);
    // The mean of the samples' squared differences from local_mean.
    float temporal_variance = max(lobe.second_moment + local_mean * (local_mean - 2.0 * value), 0.0);
    float sample_variance = (SPATIAL_VARIANCE_FRAMES * spatial_variance + lobe.frames * temporal_variance)
        / (SPATIAL_VARIANCE_FRAMES + lobe.frames);
    return Signal(lobe.radiance, sqrt(sample_variance / lobe.frames));
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy;
    uint index;
    if (denoise_settings.denoise == 0u || !find_pixel(found, index)) { return; }
    ivec2 pixel = ivec2(found), size = ivec2(camera.size);
    Guide guide = load_guide(pixel);
    if (guide.kind == NOT_DENOISED) {
        denoise_ping.at[index] = denoise_pong.at[index] = uvec4(0u, 0u, DONE_IN_BOTH << 30u, 0u);
        return;
    }
    LobeHistory own_diffuse = unpack_lobe_history(denoise_diffuse.at[index]);
    LobeHistory own_specular = unpack_lobe_history(denoise_specular.at[index]);
    Moments diffuse = Moments(0.0, 0.0, 0.0), specular = diffuse;
    LuminanceBounds bounds = LuminanceBounds(0.0, INFINITY);
    bool reflection_edges_known = own_specular.frames >= MIN_VARIANCE_FRAMES;
    float relative_error = inversesqrt(max(own_specular.frames, 1.0));
    EdgeStopping edges = make_edge_stopping(
        guide, pixel, relative_error, reflection_edges_known ? MIN_ALPHA_NOISY : MIN_ALPHA_UNKNOWN_EDGES
    );
    // After the pixel's first path those of its block may have none yet.
    int apart = own_diffuse.frames > 0.0 && own_diffuse.frames < MIN_VARIANCE_FRAMES ? block_width : 1;
    // Of 3 x 3 pixels, of which number 4 is the center.
    for (int i = 0; i < 9; i++) {
        ivec2 step = ivec2(i % 3, i / 3) - 1, other = pixel + apart * step;
        ivec2 inside = clamp(other, ivec2(0), size - 1);
        uint other_index = element_index(inside, camera.size);
        vec2 weights = vec2(inside == other ? (2 - abs(step.x)) * (2 - abs(step.y)) : 0);
        if (i != 4) { weights *= edge_stopping_weights(edges, denoise_guides.at[other_index], apart * step); }
        add_moments(diffuse, unpack_lobe_history(denoise_diffuse.at[other_index]), weights.x);
        LobeHistory other_specular = unpack_lobe_history(denoise_specular.at[other_index]);
        add_moments(specular, other_specular, weights.y);
        if (weights.x > MIN_NEIGHBOR_WEIGHT && i != 4) { add_bounds(bounds, other_specular); }
    }
    uvec4 random = pcg4d(uvec4(pixel, this_frame.index, this_frame.seed ^ PASS_SALT));
    vec2 trimmed_mean_luminance = denoise_neighborhoods.at[cell_at(pixel)].trimmed_mean_luminance;
    uint state = reflection_edges_known ? FILTERING : REFLECTION_EDGES_UNKNOWN;
    Signals signals = Signals(
        estimate_signal(own_diffuse, diffuse, trimmed_mean_luminance.x),
        estimate_signal(own_specular, specular, trimmed_mean_luminance.y), state
    );
    // At the edge of a bright reflection the jittered samples of one pixel show both sides of it, so that their
    // variance isn't only noise, and the blur would take the difference of the sides for noise. A pixel with a neighbor
    // that is brighter by more than its standard error may be on the dark side: its own standard error is then clamped
    // to the upper bound of the darkest neighbor's luminance.
    if (reflection_edges_known && bounds.max_lower_bound > luminance(own_specular.radiance)) {
        signals.specular.standard_error = min(signals.specular.standard_error, bounds.min_upper_bound);
    }
    vec2 means = vec2(diffuse.luminance_sum, specular.luminance_sum)
        / max(vec2(diffuse.weight_sum, specular.weight_sum), 1e-9);
    denoise_ping.at[index] = uvec4(pack_signals(signals, random.xyz), pack_two(means.x, means.y, random.w));
}
