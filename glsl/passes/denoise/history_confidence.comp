// Finds where light changed: where it differs from its history by more than noise, over a cell or over a block of cells
// around it. Schied et al., "Gradient Estimation for Real-Time Adaptive Temporal Filtering" (HPG 2018), retraces paths
// for such differences; here their sums over pixels tell them from noise.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/denoise/guide.glsl"
#include "passes/light_change.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void add_gradient(inout Gradient sum, Gradient other) {
    sum.difference_sum += other.difference_sum;
    sum.sum_of_squares += other.sum_of_squares;
    sum.sum_of_max += other.sum_of_max;
}

void add_neighbor_gradient(inout LobeGradient sum, LobeGradient other) {
    add_gradient(sum.current, other.current);
    add_gradient(sum.fast, other.fast);
    sum.variance_sum += other.variance_sum;
    sum.luminance_sum += other.luminance_sum;
    sum.max_luminance = max(sum.max_luminance, other.max_luminance);
    sum.pixels += other.pixels;
}

// The share of the history that remains valid. `sigmas`: CHANGE_SIGMAS. `variance`: of sum.difference_sum, as the
// variances of the histories predict it. sum.sum_of_squares is another estimate of it, from this frame; the larger one
// counts, since a history may not have met outliers yet.
float confidence(Gradient sum, float variance, vec2 sigmas) {
    float deviation = sqrt(max(sum.sum_of_squares, variance));
    if (!(deviation > 0.0)) { return 1.0; }
    float significance = smoothstep(sigmas.x, sigmas.y, abs(sum.difference_sum) / deviation);
    return pow(1.0 - significance * min(abs(sum.difference_sum) / max(sum.sum_of_max, EPSILON), 1.0), CHANGE_EXPONENT);
}

float confidence(LobeGradient sum, vec2 sigmas) {
    float fast = confidence(sum.fast, FAST_VARIANCE_RATIO * sum.variance_sum, sigmas);
    return min(confidence(sum.current, sum.variance_sum, sigmas), fast);
}

// The share of a cell's light that may have changed in recent frames: the larger of two ratios, of what the changed
// lights may send to the cell's position to the irradiance there, and of the changed to the whole power of all lights.
// Irradiance is about pi times demodulated radiance.
float cell_light_change(LobeGradient cell, vec3 position) {
    float irradiance = PI * cell.luminance_sum / max(cell.pixels, 1.0);
    return max(this_frame.lighting_change, light_change(position, irradiance, ANY_CHANGE));
}

vec2 change_sigmas(float change) {
    return mix(CHANGE_SIGMAS, CHANGE_SIGMAS_IF_EXPECTED, min((1.0 / EXPECTED_CHANGE) * change, 1.0));
}

// The mean without the brightest pixel. For too few pixels it is their sum, so that variance.comp, which clamps
// fireflies by it, clamps none of them.
float trimmed_mean_luminance_of(LobeGradient sum) {
    if (sum.pixels <= MAX_UNTRIMMED_PIXELS) { return sum.luminance_sum; }
    return max(sum.luminance_sum - sum.max_luminance, 0.0) / (sum.pixels - 1.0);
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy, cells = cell_count();
    uint index;
    if (denoise_settings.denoise == 0u || !find_element(found, cells, index)) { return; }
    ivec2 cell = ivec2(found);
    GradientCell own = denoise_cells.at[index];
    ivec2 middle = min(cell * int(CELL_SIZE) + int(CELL_SIZE) / 2, ivec2(camera.size) - 1);
    vec3 position = load_guide(middle).position + camera.world_from_view[3];
    vec2 sigmas = change_sigmas(cell_light_change(unpack_gradient(own.diffuse), position));
    vec2 specular_sigmas = change_sigmas(cell_light_change(unpack_gradient(own.specular), position));
    vec2 lobe_confidence = vec2(1.0), trimmed_mean_luminance = vec2(0.0);
    LobeGradient diffuse = NO_PIXELS, specular = NO_PIXELS;
    // Neighborhoods of 1, 3 x 3 and 5 x 5 cells: each step adds the ring of cells at the edge of the larger square.
    for (int ring = 0; ring <= MAX_NEIGHBORHOOD_RADIUS; ring++) {
        for (int y = -ring; y <= ring; y++) {
            int step = abs(y) == ring ? 1 : 2 * ring;  // in the square's inner rows only its two edges
            for (int x = -ring; x <= ring; x += max(step, 1)) {
                ivec2 other = cell + ivec2(x, y);
                if (!is_inside(other, cells)) { continue; }
                GradientCell neighbor = denoise_cells.at[element_index(other, cells)];
                add_neighbor_gradient(diffuse, unpack_gradient(neighbor.diffuse));
                add_neighbor_gradient(specular, unpack_gradient(neighbor.specular));
            }
        }
        lobe_confidence = min(
            lobe_confidence, vec2(confidence(diffuse, sigmas), confidence(specular, specular_sigmas))
        );
        if (ring == 1) {
            trimmed_mean_luminance = vec2(trimmed_mean_luminance_of(diffuse), trimmed_mean_luminance_of(specular));
        }
    }
    // With a shutter (motion blur) a picture is the mean of frames at several times of its exposure. Light that differs
    // between these times is averaged, not forgotten.
    if (this_frame.shutter_state == LATER_OF_EXPOSURE) { lobe_confidence = vec2(1.0); }
    denoise_neighborhoods.at[index] = CellNeighborhood(lobe_confidence, trimmed_mean_luminance);
}
