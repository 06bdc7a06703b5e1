// One of several passes of a blur whose width doubles from pass to pass: Dammertz et al., "Edge-Avoiding A-Trous
// Wavelet Transform for Fast Global Illumination Filtering" (HPG 2010), with a kernel of 3 x 3 pixels. A neighbor's
// weight is its edge-stopping weight times how well the standard errors of both pixels explain the difference of their
// light, so that the blur ends where histories are long. The errors of both pixels count, so that outliers are spread
// over their neighbors. In the diffuse lobe the weights are symmetric: two pixels of a surface take the same share of
// each other's light, which conserves it. In the specular lobe they depend on the center's roughness and relative
// error, so that they are symmetric only where both pixels' are equal.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/edge_stopping.glsl"
#include "passes/denoise/signal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(constant_id = level_id) const uint level = 0u;

const uint PASS_SALT = 0x3C6EF372u;

const bool READS_PING = (level & 1u) == 0u;

uvec4 load_bits(uint index) { return READS_PING ? denoise_ping.at[index] : denoise_pong.at[index]; }

void store_bits(uint index, uvec4 bits) {
    if (READS_PING) {
        denoise_pong.at[index] = bits;
    } else {
        denoise_ping.at[index] = bits;
    }
}

struct FilterSum {
    vec3 radiance;
    float weight_sum;       // sum of the edge-stopping weights
    float accepted_weight;  // sum of the signals' whole weights, with the luminance weights
    float sensitivity;      // sum of the derivatives of `radiance` by each signal, since weights depend on signals too
    float variance;         // of `radiance` if the noise of all pixels is independent
    float correlated_deviation;  // standard deviation of `radiance` if the noise of all pixels is the same
};

const FilterSum EMPTY_SUM = FilterSum(vec3(0.0), 0.0, 0.0, 0.0, 0.0, 0.0);

// sensitivity: derivative of `sum.radiance` by the signal.
void add(inout FilterSum sum, Signal signal, float weight, float sensitivity) {
    float deviation = sensitivity * signal.standard_error;
    sum.radiance += weight * signal.radiance;
    sum.accepted_weight += weight;
    sum.sensitivity += sensitivity;
    sum.variance += deviation * deviation;
    sum.correlated_deviation += deviation;
}

// What signals are compared by: in the first pass, where they have most noise, means of 3 x 3 pixels.
vec2 luminances(uint means, Signals signals) {
    if (level > 0u) { return vec2(luminance(signals.diffuse.radiance), luminance(signals.specular.radiance)); }
    return vec2(unpack_positive(means, 16u), unpack_positive(means >> 16u, 16u));
}

// How much the lights of two pixels of a metal differ, in units of their luminance: as much as the channel that differs
// most in proportion. A metal colors light less the more the light grazes it (Fresnel), while the albedo by which light
// is demodulated is a mean over all directions. So a colored texture of a metal is left in demodulated light where that
// comes from few directions, in the channels that the metal reflects least, which luminance hardly shows.
float channel_difference(Signal a, Signal b) {
    vec3 difference = abs(a.radiance - b.radiance) / max(a.radiance + b.radiance, EPSILON);
    return max_component(difference) * luminance(a.radiance + b.radiance);
}

// Whether so little noise is left in the sum of both lobes that wider passes would change nothing visible. Not where
// all is black, since wider passes may bring light there.
bool is_converged(ivec2 pixel, uint kind, Signals signals) {
    vec2 values = vec2(luminance(signals.diffuse.radiance), luminance(signals.specular.radiance));
    vec2 deviations = vec2(signals.diffuse.standard_error, signals.specular.standard_error);
    if (min(deviations.x, deviations.y) < 0.0) { return false; }
    ivec2 texel = texel_of(pixel);
    // Green stands for the luminance of the albedos.
    vec2 albedos = vec2(imageLoad(guides_diffuse_albedo, texel).g, imageLoad(guides_specular_albedo, texel).g);
    if (kind != PRIMARY_SURFACE) { albedos = vec2(0.0, 1.0); }  // all light of a PSR surface is specular
    return length(albedos * deviations) < CONVERGED_NOISE * dot(albedos, values);
}

// A neighbor's edge-stopping weight is multiplied by the square of `luminance_weight`, which says how well noise
// explains the difference of both luminances. The rest of its weight goes to the center. A neighbor that is done takes
// no light from the center; so that light is conserved, it gives none either.
// The weight falls as the signals differ more, so that the sum responds less to the neighbor's signal than its weight
// says, and more to the center's. With luminance_weight f = t / (t + d^2), where t is the tolerance and d the
// difference, the neighbor adds f^2 d to the center's signal; the derivative by d is f^2 (4 f - 3), or 0 if that is
// negative. In the first pass d is the difference of means of 3 x 3 pixels, which one signal hardly changes, so that
// the derivative is the weight.
void add_neighbor(
    inout FilterSum sum, Signal center, Signal other, float difference, float weight, bool other_done
) {
    float variance = center.standard_error * center.standard_error + other.standard_error * other.standard_error;
    float tolerance = SIGMA_LUMINANCE * SIGMA_LUMINANCE * variance + EPSILON;
    float luminance_weight = other_done ? 0.0 : tolerance / (tolerance + difference * difference);
    luminance_weight = center.standard_error < 0.0 ? 1.0 : luminance_weight;
    weight = other.standard_error < 0.0 ? 0.0 : weight;
    sum.weight_sum += weight;
    weight *= luminance_weight * luminance_weight;
    add(sum, other, weight, level == 0u ? weight : weight * max(4.0 * luminance_weight - 3.0, 0.0));
}

// The weighted mean. The center gets CENTER_WEIGHT, and what the luminance weights took from its neighbors.
Signal mean(FilterSum sum, Signal center) {
    if (center.standard_error >= 0.0) {
        sum.weight_sum += CENTER_WEIGHT;
        add(sum, center, sum.weight_sum - sum.accepted_weight, sum.weight_sum - sum.sensitivity);
    }
    if (sum.accepted_weight == 0.0) { return Signal(vec3(0.0), -1.0); }
    float correlated = sum.correlated_deviation * sum.correlated_deviation;
    float variance = mix(sum.variance, correlated, CORRELATION[min(level, 2u)]);
    return Signal(sum.radiance / sum.accepted_weight, sqrt(variance) / sum.accepted_weight);
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy;
    uint index;
    if (denoise_settings.denoise == 0u || !find_pixel(found, index)) { return; }
    ivec2 pixel = ivec2(found), size = ivec2(camera.size);
    uvec4 bits = load_bits(index);
    uint state = state_of(bits.z);
    // Turns DONE into DONE_IN_BOTH in the copy.
    if (state == DONE) { store_bits(index, bits ^ uvec4(0u, 0u, (DONE ^ DONE_IN_BOTH) << 30u, 0u)); }
    if (is_done(state)) { return; }
    Guide guide = load_guide(pixel);
    Signals own = unpack_signals(bits.xyz);
    vec2 values = luminances(bits.w, own);
    float min_alpha_if_noisy = state == REFLECTION_EDGES_UNKNOWN ? MIN_ALPHA_UNKNOWN_EDGES : MIN_ALPHA_NOISY;
    float relative_error = max(own.specular.standard_error, 0.0) / max(values.y, 1e-9);
    EdgeStopping edges = make_edge_stopping(guide, pixel, relative_error, min_alpha_if_noisy);
    // Not in the first pass, which compares means of luminances.
    bool compares_channels = level > 0u
        && max_component(imageLoad(guides_specular_albedo, texel_of(pixel)).rgb) > MIN_METAL_ALBEDO;
    FilterSum diffuse = EMPTY_SUM, specular = EMPTY_SUM;
    for (int y = -1; y <= 1; y++) {
        for (int x = -1; x <= 1; x++) {
            if (x == 0 && y == 0) { continue; }
            ivec2 step = ivec2(x, y) << level, other = pixel + step, inside = clamp(other, ivec2(0), size - 1);
            uint other_index = element_index(inside, camera.size);
            float kernel = inside == other ? float((2 - abs(x)) * (2 - abs(y))) : 0.0;
            vec2 weights = kernel * edge_stopping_weights(edges, denoise_guides.at[other_index], step);
            uvec4 other_bits = load_bits(other_index);
            Signals neighbor = unpack_signals(other_bits.xyz);
            bool other_done = is_done(neighbor.state);
            vec2 differences = luminances(other_bits.w, neighbor) - values;
            if (compares_channels) { differences.y = channel_difference(own.specular, neighbor.specular); }
            add_neighbor(diffuse, own.diffuse, neighbor.diffuse, differences.x, weights.x, other_done);
            add_neighbor(specular, own.specular, neighbor.specular, differences.y, weights.y, other_done);
        }
    }
    // Where the luminance weights reject most neighbors, since noise doesn't explain their differences or they are
    // done, wider passes would reject theirs too.
    vec2 accepted_weight = vec2(diffuse.accepted_weight, specular.accepted_weight),
        weight_sum = vec2(diffuse.weight_sum, specular.weight_sum);
    bool rejects_neighbors = level > 0u && all(lessThan(accepted_weight, MIN_ACCEPTED_RATIO * weight_sum));
    Signals filtered = Signals(mean(diffuse, own.diffuse), mean(specular, own.specular), state);
    if (rejects_neighbors || is_converged(pixel, guide.kind, filtered)) { filtered.state = DONE; }
    uvec3 random = pcg4d(uvec4(pixel, this_frame.index, this_frame.seed ^ (PASS_SALT + level))).xyz;
    store_bits(index, uvec4(pack_signals(filtered, random), 0u));
}
