// Adds the paths of a dispatch to the means of pixels.
#version 460
#include "common/math.glsl"
#include "passes/reference/path_index.glsl"
#include "passes/reference/quads.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The mean is updated sample by sample, so that its bits don't depend on how samples are split into dispatches. A mean
// keeps the precision of the millionth sample, which a sum would lose.
void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy + uvec2(0u, path_sampling.first_row);
    uint index;
    if (!find_pixel(pixel, index) || gl_GlobalInvocationID.xy.y >= path_sampling.row_count) { return; }
    uvec2 range = sample_range(pixel);
    if (range.x >= range.y) { return; }
    vec3 mean = vec3(0.0);
    float squared_deviations = 0.0;  // their sum
    uint all_rays = 0u;
    if (range.x > 0u) {
        mean = radiance_mean.at[index];
        squared_deviations = luminance_deviations.at[index];
        all_rays = ray_count.at[index];
    }
    uint path = first_path(gl_GlobalInvocationID.xy);
    for (uint sample_index = range.x; sample_index < range.y; sample_index++) {
        uint rays;
        vec3 radiance = load_radiance(path, rays);
        // Welford, "Note on a Method for Calculating Corrected Sums of Squares and Products" (1962)
        vec3 difference = radiance - mean;
        mean += difference / float(sample_index + 1u);
        squared_deviations += luminance(difference) * luminance(radiance - mean);
        all_rays += rays;
        path += paths_per_sample();
    }
    radiance_mean.at[index] = mean;
    luminance_deviations.at[index] = squared_deviations;
    ray_count.at[index] = all_rays;
}
