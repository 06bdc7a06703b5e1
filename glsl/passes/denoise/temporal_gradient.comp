// Adds up for each gradient cell how much this frame's light, and that of the latest frames, differ from the mean of
// all earlier frames. Unlike A-SVGF it retraces no paths: in sums over many pixels noise averages out, changes of light
// stay.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/denoise/noisy_input.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x1F83D9ABu;

void add_gradient(inout Gradient sum, float value, float mean) {
    sum.difference_sum += value - mean;
    sum.sum_of_squares += square(value - mean);
    sum.sum_of_max += max(value, mean);
}

// What is compared of this frame's light: red counts most in one frame and blue in the next, as light may change its
// hue and keep its luminance.
float compared(vec3 color) {
    return dot(color, (this_frame.index & 1u) == 0u ? vec3(0.6, 0.3, 0.1) : vec3(0.1, 0.3, 0.6));
}

// compared_sum: as cell.luminance_sum, of what is compared. young: the gradient of histories that are too short to tell
// how noisy they are.
void add_pixel(
    inout LobeGradient cell, inout float compared_sum, inout Gradient young, LobeHistory history, vec3 radiance
) {
    if (!is_finite_color(radiance)) { return; }
    vec3 updated_mean = mix(history.radiance, radiance, 1.0 / (history.frames + 1.0));
    compared_sum += compared(updated_mean);
    cell.luminance_sum += luminance(updated_mean);
    cell.max_luminance = max(cell.max_luminance, luminance(updated_mean));
    cell.pixels += 1.0;
    if (history.frames == 0.0) { return; }
    if (history.frames < MIN_GRADIENT_FRAMES) {
        add_gradient(young, compared(radiance), compared(history.radiance));
        return;
    }
    float value = luminance(radiance), mean = luminance(history.radiance);
    cell.variance_sum += max(history.second_moment - mean * mean, 0.0);
    add_gradient(cell.current, compared(radiance), compared(history.radiance));
    add_gradient(cell.fast, mix(history.fast_luminance, value, FAST_WEIGHT), mean);
}

// The gradient of what is compared as one of luminance, which variances are of, by the ratio in the cell's mean color.
// Young histories count only in cells that have no others.
Gradient as_luminance(Gradient sum, Gradient young, float luminance_sum, float compared_sum) {
    if (sum.sum_of_max == 0.0) {
        sum = young;
        sum.sum_of_squares *= YOUNG_VARIANCE_RATIO;
    }
    float scale = luminance_sum / max(compared_sum, EPSILON);
    return Gradient(scale * sum.difference_sum, scale * scale * sum.sum_of_squares, scale * sum.sum_of_max);
}

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy, cells = cell_count();
    uint cell_index;
    if (denoise_settings.denoise == 0u || !find_element(cell, cells, cell_index)) { return; }
    uvec2 begin = cell * CELL_SIZE, end = min(begin + CELL_SIZE, camera.size);
    LobeGradient diffuse = NO_PIXELS, specular = NO_PIXELS;
    float diffuse_compared = 0.0, specular_compared = 0.0;
    Gradient young_diffuse = NO_GRADIENT, young_specular = NO_GRADIENT;
    for (uint y = begin.y; y < end.y; y++) {
        for (uint x = begin.x; x < end.x; x++) {
            uint index = element_index(uvec2(x, y), camera.size), kind = kind_of(denoise_guides.at[index]);
            if (kind == NOT_DENOISED || has_no_path(noisy_diffuse(index))) { continue; }
            LobeHistory diffuse_history = unpack_lobe_history(denoise_diffuse.at[index]);
            LobeHistory specular_history = unpack_lobe_history(denoise_specular.at[index]);
            vec3 specular_radiance = noisy_specular(index, ivec2(x, y), kind).rgb;
            add_pixel(diffuse, diffuse_compared, young_diffuse, diffuse_history, noisy_diffuse(index).rgb);
            add_pixel(specular, specular_compared, young_specular, specular_history, specular_radiance);
        }
    }
    diffuse.current = as_luminance(diffuse.current, young_diffuse, diffuse.luminance_sum, diffuse_compared);
    specular.current = as_luminance(specular.current, young_specular, specular.luminance_sum, specular_compared);
    uint rng = seed_rng(cell, this_frame.index, this_frame.seed ^ PASS_SALT);
    denoise_cells.at[cell_index] = GradientCell(pack_gradient(diffuse, rng), pack_gradient(specular, rng));
}
