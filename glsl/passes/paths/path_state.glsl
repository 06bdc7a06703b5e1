// Paths that wait for their next ray. They go on in rounds, each a dispatch over those that are left, because threads
// that run together would otherwise wait for the few among them with long paths: Laine, Karras and Aila, "Megakernels
// Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/path.glsl"

const uint REFLECTS_ONLY = 0x80000000u;
const uint LEAVES_DIFFUSELY = 0x40000000u;

// The first entry of a round's list.
uint queue_begin(uint wave_index) { return wave_index % 2u * (paths_ray_queues.at.length() / 2u); }

void store_path_state(Path path, uint pixel_index, uint wave_index) {
    uint state = path.bounce | path.mirrors << 8u | (path.reflects_only ? REFLECTS_ONLY : 0u)
        | (path.leaves_diffusely ? LEAVES_DIFFUSELY : 0u);
    uint row = atomicAdd(paths_wave.queued, 1u);
    paths_ray_queues.at[queue_begin(wave_index) + row] = pixel_index;
    paths_states.at[pixel_index] = PathState(
        path.rng, state, indirect_light(path, vec3(1.0)), path.walk.throughput, path.walk.direction, path.hit.instance,
        path.hit.triangle, path.hit.barycentrics, path.squared_slope, path.spread, path.walk.cone_width,
        path.walk.medium.material
    );
}

// The path as it was, but for the light that it has found, which is already in the pixel.
Path load_path_state(uint pixel_index) {
    PathState state = paths_states.at[pixel_index];
    Path path = start_path(state.rng);
    path.bounce = state.state & 0xFFu;
    path.mirrors = state.state >> 8u & 0xFFu;
    path.leaves_diffusely = (state.state & LEAVES_DIFFUSELY) != 0u;
    path.reflects_only = (state.state & REFLECTS_ONLY) != 0u;
    path.first_weight = state.first_weight;
    path.walk.throughput = state.throughput;
    path.walk.direction = state.direction;
    path.hit = Hit(0.0, state.instance, state.triangle, state.barycentrics, false);
    path.squared_slope = state.squared_slope;
    path.spread = state.spread;
    path.walk.cone_width = state.cone_width;
    path.walk.medium = Medium(state.medium);
    ResolvedRayHitFull surface = resolve_ray_hit_full(path.hit, path.walk.direction, path.walk.cone_width);
    vec3 counted = vec3(1.0);  // already
    remove_straight_transmission(path.hit, path.walk.direction, surface.material, counted);
    arrive(path, surface);
    return path;
}

#endif
