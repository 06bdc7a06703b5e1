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

void add_pixel(inout LobeGradient cell, LobeHistory history, vec3 radiance) {
    if (!is_finite_color(radiance)) { return; }
    float value = luminance(radiance), mean = luminance(history.radiance);
    float updated_mean = mix(mean, value, 1.0 / (history.frames + 1.0));
    cell.luminance_sum += updated_mean;
    cell.max_luminance = max(cell.max_luminance, updated_mean);
    cell.pixels += 1.0;
    if (history.frames < MIN_GRADIENT_FRAMES) { return; }
    cell.variance_sum += max(history.second_moment - mean * mean, 0.0);
    add_gradient(cell.current, value, mean);
    add_gradient(cell.fast, mix(history.fast_luminance, value, FAST_WEIGHT), mean);
}

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy, cells = cell_count();
    uint cell_index;
    if (denoise_settings.denoise == 0u || !find_element(cell, cells, cell_index)) { return; }
    uvec2 begin = cell * CELL_SIZE, end = min(begin + CELL_SIZE, camera.size);
    LobeGradient diffuse = NO_PIXELS, specular = NO_PIXELS;
    for (uint y = begin.y; y < end.y; y++) {
        for (uint x = begin.x; x < end.x; x++) {
            uint index = element_index(uvec2(x, y), camera.size), kind = kind_of(denoise_guides.at[index]);
            if (kind == NOT_DENOISED || has_no_path(noisy_diffuse(index))) { continue; }
            add_pixel(diffuse, unpack_lobe_history(denoise_diffuse.at[index]), noisy_diffuse(index).rgb);
            vec4 specular_value = noisy_specular(index, ivec2(x, y), kind);
            add_pixel(specular, unpack_lobe_history(denoise_specular.at[index]), specular_value.rgb);
        }
    }
    uint rng = seed_rng(cell, this_frame.index, this_frame.seed ^ PASS_SALT);
    denoise_cells.at[cell_index] = GradientCell(pack_gradient(diffuse, rng), pack_gradient(specular, rng));
}
