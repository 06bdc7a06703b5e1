// The paths of a dispatch: one for each sample of each pixel.
#ifndef PASSES_REFERENCE_PATH_INDEX_GLSL
#define PASSES_REFERENCE_PATH_INDEX_GLSL

#include "passes/reference/bindings.glsl"
#include "passes/views.glsl"

// The samples that a pixel takes in this dispatch: from index x to y - 1.
uvec2 sample_range(uvec2 pixel) {
    uvec2 uniform_range = path_sampling.sample_index + uvec2(0u, path_sampling.samples_per_dispatch);
#ifdef MANY_VIEWS
    return uniform_range;
#else
    if (path_sampling.has_sample_ranges == 0u) { return uniform_range; }
    uint block = pixel.y / 8u * ((camera.size.x + 7u) / 8u) + pixel.x / 8u;
    uvec2 range = sample_ranges.at[2u * block + (pixel.x + pixel.y) % 2u];
    return min(range.x + uniform_range, range.y);  // counted from the first sample of the range
#endif
}

// The squares of 8 by 8 pixels that the rows of this dispatch have in x and y. Paths of a square follow each other,
// since nearby rays meet the same nodes.
uvec2 square_counts() {
#ifdef MANY_VIEWS
    uint width = views.columns * camera.size.x;
#else
    uint width = camera.size.x;
#endif
    return (uvec2(width, path_sampling.row_count) + SQUARE - 1u) / SQUARE;
}

const uint SQUARE_PATHS = SQUARE * SQUARE;

uint paths_per_sample() {
    uvec2 squares = square_counts();
    return squares.x * squares.y * SQUARE_PATHS;
}

// The path of the first sample of a pixel, which is counted from the first row of this dispatch.
uint first_path(uvec2 pixel) {
    uvec2 square = pixel / SQUARE, within = pixel % SQUARE;
    return (square.y * square_counts().x + square.x) * SQUARE_PATHS + within.y * SQUARE + within.x;
}

// The pixel and the sample of a path. Returns false where there is none.
bool find_path(uint path, out uvec2 pixel, out uint sample_index) {
    uint square = path % paths_per_sample() / SQUARE_PATHS, within = path % SQUARE_PATHS;
    uint columns = square_counts().x;
    pixel = SQUARE * uvec2(square % columns, square / columns) + uvec2(within % SQUARE, within / SQUARE);
    bool in_rows = pixel.y < path_sampling.row_count;
    pixel.y += path_sampling.first_row;
    uint index;
    if (!in_rows || !find_pixel(pixel, index)) { return false; }
    uvec2 range = sample_range(pixel);
    sample_index = range.x + path / paths_per_sample();
    return sample_index < range.y;
}

#endif
