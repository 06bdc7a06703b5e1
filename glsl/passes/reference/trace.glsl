// The loop of the path tracer: updates each pixel's mean with more samples. A shader that includes this file says where
// paths start.
#ifndef PASSES_REFERENCE_TRACE_GLSL
#define PASSES_REFERENCE_TRACE_GLSL

#include "passes/reference/path.glsl"

void trace_paths() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    uint index;
    if (!find_pixel(pixel, index) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }

    uvec2 range = sample_range(pixel);
    if (range.x >= range.y) { return; }
    PixelMean mean = load_mean(index, range.x);
    Medium medium = find_medium(start_position(pixel));

    // One loop over the rays of all samples: when a path ends, the next one starts, so invocations don't wait for the
    // longest path of their neighbors.
    bool path_ended = true;
    uint rng;
    Path path;
    Vertex vertex;
    while (true) {
        if (path_ended) {
            if (mean.samples == range.y) { break; }
            begin_path(path);
        }
        begin_random_numbers(pixel, mean.samples, path.bounce, rng);
        bool at_vertex = path_ended && start_path(pixel, path, vertex, rng);
        if (path_ended) { path.walk.medium = medium; }
        at_vertex = at_vertex || reach_vertex(path, trace_walk(path, rng), vertex, rng);
        path_ended = !at_vertex || !leave_vertex(path, vertex, rng);
        trace_shadow_ray(path);
        if (path_ended) { add_sample(mean, path.radiance, path.rays); }
    }
    store_mean(index, mean);
}

#endif
