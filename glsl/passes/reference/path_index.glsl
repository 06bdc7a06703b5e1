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

// Paths of a square of 8 by 8 pixels follow each other, since nearby rays meet the same nodes. Squares are lower where
// a dispatch has fewer rows.
uvec2 square_size() { return uvec2(SQUARE, min(SQUARE, path_sampling.row_count)); }

// The squares that the rows of this dispatch have in x and y.
uvec2 square_counts() {
#ifdef MANY_VIEWS
    uint width = views.columns * camera.size.x;
#else
    uint width = camera.size.x;
#endif
    return (uvec2(width, path_sampling.row_count) + square_size() - 1u) / square_size();
}

uint paths_per_square() { return square_size().x * square_size().y; }

uint paths_per_sample() {
    uvec2 squares = square_counts();
    return squares.x * squares.y * paths_per_square();
}

// The path of the first sample of a pixel, which is counted from the first row of this dispatch.
uint first_path(uvec2 pixel) {
    uvec2 square = pixel / square_size(), within = pixel % square_size();
    return (square.y * square_counts().x + square.x) * paths_per_square() + within.y * SQUARE + within.x;
}

// The pixel and the sample of a path. Returns false where there is none.
bool find_path(uint path, out uvec2 pixel, out uint sample_index) {
    uint square = path % paths_per_sample() / paths_per_square(), within = path % paths_per_square();
    uint columns = square_counts().x;
    pixel = square_size() * uvec2(square % columns, square / columns) + uvec2(within % SQUARE, within / SQUARE);
    bool in_rows = pixel.y < path_sampling.row_count;
    pixel.y += path_sampling.first_row;
    uint index;
    if (!in_rows || !find_pixel(pixel, index)) { return false; }
    uvec2 range = sample_range(pixel);
    sample_index = range.x + path / paths_per_sample();
    return sample_index < range.y;
}

#endif
