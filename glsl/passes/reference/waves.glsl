// The path tracer's paths are traced in waves. Each is a pass that traces the next rays of all paths that go on, and
// one that shades what they hit: a shader that only traces needs few registers, and no thread waits for longer paths.
// Laine, Karras and Aila, "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_REFERENCE_WAVES_GLSL
#define PASSES_REFERENCE_WAVES_GLSL

#include "passes/reference/stored_path.glsl"  // first: path.glsl chooses the kind of random numbers
#include "passes/reference/path_index.glsl"

uint queue_begin(uint wave_index) { return wave_index % 2u * (wave_queues.at.length() / 2u); }

// Has a path wait for the next wave.
void queue_path(uint path) {
    uint place = atomicAdd(wave.queued, 1u);
    wave_queues.at[queue_begin(wave.index + 1u) + place] = path;
}

// The path of this wave with which an invocation goes on.
bool find_waiting_path(uvec2 invocation, out uint path, out uvec2 pixel, out uint sample_index) {
    uint thread = thread_index(invocation);
    if (thread >= wave.count) { return false; }
    path = wave_queues.at[queue_begin(wave.index) + thread];
    find_path(path, pixel, sample_index);
    choose_sample(sample_index);
    return true;
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
