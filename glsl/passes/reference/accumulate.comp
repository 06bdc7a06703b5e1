// Adds the paths of a dispatch to the pixels' means.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    uint index;
    if (!find_pixel(pixel, index) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }
    uvec2 range = sample_range(pixel);
    if (range.x >= range.y) { return; }
    PixelMean mean = load_mean(index, range.x);
    uint path = first_path(INVOCATION_INDEX);
    while (mean.samples < range.y) {
        add_sample(mean, waiting_paths.at[path].path.radiance, waiting_paths.at[path].path.rays);
        path += paths_per_sample();
    }
    store_mean(index, mean);
}
