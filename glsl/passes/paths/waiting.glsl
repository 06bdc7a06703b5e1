// Paths that wait for their next ray. They go on in rounds, each a dispatch over those that are left, because threads
// that run together would otherwise wait for the few among them with long paths: Laine, Karras and Aila, "Megakernels
// Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_WAITING_GLSL
#define PASSES_PATHS_WAITING_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/path.glsl"

const uint REFLECTS_ONLY = 0x80000000u;
const uint SHARES = 0x40000000u;

// The first entry of a round's list.
uint first_entry(uint round_index) { return round_index % 2u * (paths_lists.at.length() / 2u); }

void wait(Path path, uint pixel_index, uint round_index) {
    uint state = path.bounce | path.mirrors << 8u | (path.reflects_only ? REFLECTS_ONLY : 0u)
        | (path.shares ? SHARES : 0u);
    uint row = atomicAdd(paths_round.arrived, 1u);
    paths_lists.at[first_entry(round_index) + row] = pixel_index;
    paths_waiting.at[pixel_index] = WaitingPath(
        path.rng, state, indirect_light(path, vec3(1.0)), path.walk.throughput, path.walk.direction, path.hit.instance,
        path.hit.triangle, path.hit.barycentrics, path.squared_slope, path.spread, path.walk.cone_width,
        path.walk.medium.material
    );
}

// The path as it was, but for the light that it has found, which is already in the pixel.
Path take_waiting_path(uint pixel_index) {
    WaitingPath waiting = paths_waiting.at[pixel_index];
    Path path = start_path(waiting.rng);
    path.bounce = waiting.state & 0xFFu;
    path.mirrors = waiting.state >> 8u & 0xFFu;
    path.shares = (waiting.state & SHARES) != 0u;
    path.reflects_only = (waiting.state & REFLECTS_ONLY) != 0u;
    path.first_weight = waiting.first_weight;
    path.walk.throughput = waiting.throughput;
    path.walk.direction = waiting.direction;
    path.hit = Hit(0.0, waiting.instance, waiting.triangle, waiting.barycentrics, false);
    path.squared_slope = waiting.squared_slope;
    path.spread = waiting.spread;
    path.walk.cone_width = waiting.cone_width;
    path.walk.medium = Medium(waiting.medium);
    ResolvedRayHitFull surface = resolve_ray_hit_full(path.hit, path.walk.direction, path.walk.cone_width);
    vec3 counted = vec3(1.0);  // already
    take_wall_as_met(path.hit, path.walk.direction, surface.material, counted);
    arrive(path, surface);
    return path;
}

#endif
