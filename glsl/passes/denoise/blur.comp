// One of several passes of a blur whose width doubles from pass to pass: Dammertz et al., "Edge-Avoiding A-Trous
// Wavelet Transform for Fast Global Illumination Filtering" (HPG 2010). Pixels count by how alike their surfaces are,
// and by how well the uncertainty of their light explains its difference, so that the blur ends where histories are
// long. Both pixels' uncertainties count, so that outliers are spread over their neighbors and no energy is lost.
#version 460
#include "passes/denoise/likeness.glsl"
#include "passes/denoise/lobe.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(constant_id = 2) const uint level = 0u;

const uint PASS_SALT = 0x3C6EF372u;
const float TOLERANCE = 1.8;       // standard deviations
const float CENTER_WEIGHT = 4.0;
const float DARKEST = 1e-30;
const float CLEAN = 0.04;          // standard deviation over mean
// Of the noise of the pixels that a pass averages, by its level, since earlier passes averaged some of the same pixels.
const float CORRELATION[3] = float[](0.0, 0.081, 0.125);

uvec4 load_bits(uint index) { return (level & 1u) == 0u ? denoise_even.at[index] : denoise_odd.at[index]; }

void store_bits(uint index, uvec4 bits) {
    if ((level & 1u) == 0u) {
        denoise_odd.at[index] = bits;
    } else {
        denoise_even.at[index] = bits;
    }
}

struct Sum {
    vec3 radiance;
    float weight;
    float response;   // by how much the sum changes when all its signals change by 1
    float variance;
    float deviation;
};

// response: by how much the sum changes when the signal changes by 1.
void add(inout Sum sum, Signal signal, float weight, float response) {
    sum.radiance += weight * signal.radiance;
    sum.weight += weight;
    sum.response += response;
    sum.variance += response * response * signal.variance;
    sum.deviation += response * sqrt(signal.variance);
}

// What signals are compared by: in the first pass, where they have most noise, means of 3 x 3 pixels.
vec2 luminances(uint index, Signal diffuse, Signal specular) {
    if (level == 0u) { return denoise_luminance.at[index]; }
    return vec2(luminance(diffuse.radiance), luminance(specular.radiance));
}

// Whether wider passes would change nothing that can be seen in the sum of both lobes.
bool is_clean(ivec2 pixel, uint kind, vec2 values, vec2 variances) {
    if (min(variances.x, variances.y) < 0.0) { return false; }
    vec2 albedos = vec2(imageLoad(guides_diffuse_albedo, pixel).g, imageLoad(guides_specular_albedo, pixel).g);
    if (kind != SURFACE_SHOWN) { albedos = vec2(0.0, 1.0); }
    return dot(albedos * albedos, variances) <= square(CLEAN * dot(albedos, values));
}

// A neighbor counts by how well noise explains its difference. Since its weight falls when it differs more, the sum
// responds less to the neighbor than the weight says, and more to the center. In the first pass, weights hardly depend
// on the signals themselves.
void add_neighbor(inout Sum sum, Signal center, Signal other, float difference, float weight) {
    if (other.variance < 0.0) { return; }
    if (center.variance < 0.0) {
        add(sum, other, weight, weight);
        return;
    }
    float tolerance = TOLERANCE * TOLERANCE * (center.variance + other.variance) + DARKEST;
    float unlike = difference * difference / tolerance;
    weight /= square(1.0 + unlike);
    float response = level == 0u ? weight : weight * max(1.0 - 3.0 * unlike, 0.0) / (1.0 + unlike);
    add(sum, other, weight, response);
}

// The mean of the sum and the center.
Signal mean(Sum sum, Signal center) {
    if (center.variance >= 0.0) { add(sum, center, CENTER_WEIGHT, sum.weight + CENTER_WEIGHT - sum.response); }
    if (sum.weight == 0.0) { return Signal(vec3(0.0), -1.0); }
    float variance = mix(sum.variance, square(sum.deviation), CORRELATION[min(level, 2u)]);
    return Signal(sum.radiance / sum.weight, variance / square(sum.weight));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = ivec2(camera.size);
    if (denoise_settings.denoise == 0u || any(greaterThanEqual(pixel, size))) { return; }
    uint index = uint(pixel.y) * camera.size.x + uint(pixel.x);
    Guide guide = load_guide(pixel);
    if (guide.kind == NOTHING_SHOWN) { return; }
    uvec4 bits = load_bits(index);
    Signal diffuse = unpack_signal(bits.xy), specular = unpack_signal(bits.zw);
    vec2 values = luminances(index, diffuse, specular);
    if (level > 0u && is_clean(pixel, guide.kind, values, vec2(diffuse.variance, specular.variance))) {
        store_bits(index, bits);
        return;
    }
    Pattern pattern = make_pattern(guide, sqrt(max(specular.variance, 0.0)) / max(values.y, 1e-9));
    Sum diffuse_sum = Sum(vec3(0.0), 0.0, 0.0, 0.0, 0.0), specular_sum = diffuse_sum;

    int stride = 1 << level;
    for (int i = 0; i < 9; i++) {
        ivec2 direction = ivec2(i % 3, i / 3) - 1, step = direction * stride, other = pixel + step;
        if (i == 4 || any(lessThan(other, ivec2(0))) || any(greaterThanEqual(other, size))) { continue; }
        uint at = uint(other.y) * camera.size.x + uint(other.x);
        vec2 weights = likeness(pattern, denoise_guides.at[at], step);
        if (max(weights.x, weights.y) < 1e-3) { continue; }
        weights *= float((2 - abs(direction.x)) * (2 - abs(direction.y)));
        uvec4 other_bits = load_bits(at);
        Signal other_diffuse = unpack_signal(other_bits.xy), other_specular = unpack_signal(other_bits.zw);
        vec2 apart = luminances(at, other_diffuse, other_specular) - values;
        add_neighbor(diffuse_sum, diffuse, other_diffuse, apart.x, weights.x);
        add_neighbor(specular_sum, specular, other_specular, apart.y, weights.y);
    }
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ (PASS_SALT + level));
    uvec2 by_diffuse = pack_signal(mean(diffuse_sum, diffuse), rng);
    uvec2 by_specular = pack_signal(mean(specular_sum, specular), rng);
    store_bits(index, uvec4(by_diffuse, by_specular));
}
