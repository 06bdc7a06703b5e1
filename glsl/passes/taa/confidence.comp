// Finds the share of the histories around each cell that is still true: where the samples of the cell, or of the 3 x 3
// cells around it, have changed by more than noise, less of them is. As Schied et al., "Gradient Estimation for
// Real-Time Adaptive Temporal Filtering" (HPG 2018), but with sums over pixels in place of paths that are traced again.
#version 460
#include "common/math.glsl"
#include "common/pixel.glsl"
#include "generated/passes/taa.glsl"  // CELL_SIZE
#include "passes/bindings.glsl"
#include "passes/taa/bindings.glsl"
#include "passes/taa/constants.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The share of their light by which the samples that differ have changed: 0 for what noise explains, and where it is
// too small a part of all light around. Samples that don't differ don't count, or they would keep the others' past.
float changed_share(SampleChange sum) {
    float expected = min(this_frame.expected_change / EXPECTED_CHANGE, 1.0);
    float noise = mix(NOISE_SIGMAS[0], NOISE_SIGMAS[1], expected);
    float change = mix(CHANGE_SIGMAS[0], CHANGE_SIGMAS[1], expected);
    float least = mix(MIN_CHANGE, MIN_EXPECTED_CHANGE, expected);
    float brightest = MIN_CHANNEL * max_component(sum.sum_of_max), most = 0.0;
    for (int i = 0; i < 3; i++) {
        float difference = abs(sum.difference_sum[i]);
        if (difference == 0.0) { continue; }
        float significance = smoothstep(noise, change, difference * inversesqrt(sum.sum_of_squares[i]))
            * smoothstep(least, 2.0 * least, difference / max(sum.sum_of_max[i], brightest));
        most = max(most, significance * sum.sum_of_shares[i] / sum.sum_of_sizes[i]);
    }
    return min(most, 1.0);
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy, cells = (camera.size + CELL_SIZE - 1u) / CELL_SIZE;
    uint index;
    if (taa_settings.antialiasing == 0u || !find_element(found, cells, index)) { return; }
    // The samples of a fine regular pattern, such as stripes, differ together from frame to frame as their places do:
    // a still picture would never have the means of its pixels if they counted.
    if (this_frame.expected_change == 0.0) {
        taa_confidence.at[index] = 1.0;
        return;
    }
    SampleChange sum = taa_changes.at[index];
    float share = changed_share(sum);
    for (int i = 0; i < 9; i++) {
        ivec2 other = ivec2(found) + ivec2(i % 3, i / 3) - 1;
        if (i != 4 && is_inside(other, cells)) { add_change(sum, taa_changes.at[element_index(other, cells)]); }
    }
    share = max(share, changed_share(sum));
    taa_confidence.at[index] = pow(1.0 - share, CHANGE_EXPONENT);
}
