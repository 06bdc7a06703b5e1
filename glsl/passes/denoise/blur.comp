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
const float TOLERANCE = 2.5;       // standard deviations
const float MIN_LOBE_TAN = 0.02;   // half width of a mirror's blur
const float DARKEST = 1e-30;
const float CLEAN = 0.02;          // standard deviation over mean

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
    float variance;
    float weight;
};

void add(inout Sum sum, Signal signal, float weight) {
    sum.radiance += weight * signal.radiance;
    sum.variance += weight * weight * signal.variance;
    sum.weight += weight;
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

// The weight of a signal by its difference from the center's.
float explained(Signal center, Signal other, float difference) {
    if (other.variance < 0.0) { return 0.0; }
    if (center.variance < 0.0) { return 1.0; }
    float tolerance = TOLERANCE * TOLERANCE * (center.variance + other.variance) + DARKEST;
    return 1.0 / square(1.0 + difference * difference / tolerance);
}

Signal mean(Sum sum) {
    return sum.weight > 0.0
        ? Signal(sum.radiance / sum.weight, sum.variance / (sum.weight * sum.weight)) : Signal(vec3(0.0), -1.0);
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
    Sum diffuse_sum = Sum(vec3(0.0), 0.0, 0.0), specular_sum = diffuse_sum;
    if (diffuse.variance >= 0.0) { add(diffuse_sum, diffuse, 4.0); }
    if (specular.variance >= 0.0) { add(specular_sum, specular, 4.0); }

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
        add(diffuse_sum, other_diffuse, weights.x * explained(diffuse, other_diffuse, apart.x));
        add(specular_sum, other_specular, weights.y * explained(specular, other_specular, apart.y));
    }
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ (PASS_SALT + level));
    uvec2 by_diffuse = pack_signal(mean(diffuse_sum), rng);
    uvec2 by_specular = pack_signal(mean(specular_sum), rng);
    store_bits(index, uvec4(by_diffuse, by_specular));
}
