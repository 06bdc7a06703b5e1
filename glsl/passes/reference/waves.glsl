// The path tracer's paths, which are traced in waves. A dispatch has a path for each sample of each pixel. Each wave is a
// pass that traces the next rays of all paths that go on, and one that shades what they hit: a shader that only traces
// needs few registers, and none waits for the few long paths. Laine, Karras and Aila, "Megakernels Considered Harmful:
// Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_REFERENCE_WAVES_GLSL
#define PASSES_REFERENCE_WAVES_GLSL

#include "passes/reference/stored_path.glsl"
#include "passes/reference/wave.glsl"

// The indices of the paths of a wave: those of waves with even index, then those of waves with odd index.
layout(set = 1, scalar) buffer WaveQueuesBlock { uint at[]; } wave_queues;

// Adaptive sampling, planned by solari_vk/output/adaptive.py: the numbers of samples before and after a pass, for each
// half of a block of 8x8 pixels, which is divided like a checkerboard. The number of a half depends on the error of the
// other half and of other blocks, since a mean is biased if its own samples decide when it stops. With many views
// sampling isn't adaptive.
layout(set = 1, scalar) readonly buffer SampleRangesBlock { uvec2 at[]; } sample_ranges;

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

// The squares of 8 by 8 pixels that the rows of this dispatch have in x and y. Paths of a square follow each other, since
// nearby rays meet the same nodes.
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
    choose_sample(sample_index);
    return sample_index < range.y;
}

uint queue_begin(uint wave_index) { return wave_index % 2u * (wave_queues.at.length() / 2u); }

void queue_path(uint path, uint wave_index) {
    uint place = atomicAdd(wave.queued, 1u);
    wave_queues.at[queue_begin(wave_index) + place] = path;
}

// The path of this wave with which an invocation goes on.
bool find_waiting_path(uvec2 invocation, out uint path, out uvec2 pixel, out uint sample_index) {
    uint thread = thread_index(invocation);
    if (thread >= wave.count) { return false; }
    path = wave_queues.at[queue_begin(wave.index) + thread];
    return find_path(path, pixel, sample_index);
}

// Whether a path has rays to trace. If not, it has ended.
bool has_rays(WaitingPath waiting) { return waiting.walks || waiting.path.shadow_ray.radiance != vec3(0.0); }

Segment trace_rays(inout WaitingPath waiting) {
    trace_shadow_ray(waiting.path);
    if (waiting.walks) { return trace_walk(waiting.path, waiting.rng); }
    return Segment(NO_HIT, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
}

// Makes the next vertex of a path that walks, and chooses the rays from there.
void shade(inout WaitingPath waiting, Segment segment, uvec2 pixel, uint sample_index) {
    Vertex vertex;
    waiting.walks = reach_vertex(waiting.path, segment, vertex, waiting.rng)
        && leave_vertex(waiting.path, vertex, waiting.rng);
    waiting.rng = next_rng(pixel, sample_index, waiting.path.bounce, waiting.rng);
}

#endif
