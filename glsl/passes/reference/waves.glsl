// The path tracer's paths in waves, as realtime paths are traced apart (solari_vk/passes/paths.py): each wave is a pass
// that traces the rays of all paths that go on, and one that shades what they hit. A dispatch has a path for each sample
// of each pixel.
#ifndef PASSES_REFERENCE_WAVES_GLSL
#define PASSES_REFERENCE_WAVES_GLSL

#include "passes/reference/from_camera.glsl"
#include "passes/reference/wave.glsl"

struct WaitingPath {
    Path path;
    bool walks;       // whether the path has a ray besides its shadow ray
    Segment segment;  // what that ray has found, once it is traced
    uint rng;
};

layout(set = 1, scalar) buffer WaitingPathsBlock { WaitingPath at[]; } waiting_paths;
// The indices of the paths of a wave: those of waves with even index, then those of waves with odd index.
layout(set = 1, scalar) buffer WaveQueuesBlock { uint at[]; } wave_queues;

const uint SQUARE_THREADS = SQUARE * SQUARE;

// The squares of 8 by 8 pixels that the rows of this dispatch have in x and y.
uvec2 square_counts() {
#ifdef MANY_VIEWS
    uint width = views.columns * camera.size.x;
#else
    uint width = camera.size.x;
#endif
    return (uvec2(width, path_sampling.row_count) + SQUARE - 1u) / SQUARE;
}

// The paths of a dispatch that takes one sample of each pixel. Paths of a square follow each other, since nearby rays
// traverse the same nodes.
uint paths_per_sample() {
    uvec2 squares = square_counts();
    return squares.x * squares.y * SQUARE_THREADS;
}

// The path of a pixel's first sample, for an invocation of a dispatch over the pixels of its rows.
uint first_path(uvec2 invocation) {
    uvec2 square = invocation / SQUARE, within = invocation % SQUARE;
    return (square.y * square_counts().x + square.x) * SQUARE_THREADS + within.y * SQUARE + within.x;
}

// The pixel and the sample of a path. Returns false where there is none.
bool find_path(uint path, out uvec2 pixel, out uint sample_index) {
    uint square = path % paths_per_sample() / SQUARE_THREADS, within = path % SQUARE_THREADS;
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

uint queue_begin(uint wave_index) { return wave_index % 2u * (wave_queues.at.length() / 2u); }

void queue_path(uint path, uint wave_index) {
    wave_queues.at[queue_begin(wave_index) + atomicAdd(wave.queued, 1u)] = path;
}

// The path that an invocation of this wave goes on with. Sets the view and the index in sequences of random numbers.
bool find_waiting_path(uvec2 invocation, out uint path, out uvec2 pixel, out uint sample_index) {
    uint thread = thread_index(invocation);
    if (thread >= wave.count) { return false; }
    path = wave_queues.at[queue_begin(wave.index) + thread];
    find_path(path, pixel, sample_index);
    sequence_index = path_sampling.first_sample + sample_index;
    return true;
}

void trace_rays(inout WaitingPath waiting) {
    trace_shadow_ray(waiting.path);
    if (waiting.walks) { waiting.segment = trace_walk(waiting.path, waiting.rng); }
}

// Makes the next vertex of a path that has a ray, and chooses the rays from there. Returns whether the path waits again.
bool shade(inout WaitingPath waiting, uvec2 pixel, uint sample_index) {
    Vertex vertex;
    waiting.walks = reach_vertex(waiting.path, waiting.segment, vertex, waiting.rng)
        && leave_vertex(waiting.path, vertex, waiting.rng);
    begin_random_numbers(pixel, sample_index, waiting.path.bounce, waiting.rng);
    return waiting.walks || waiting.path.shadow_ray.radiance != vec3(0.0);
}

#endif
