// Paths that wait for their next ray. They are traced in waves: each is a dispatch over the paths that are left,
// because a subgroup would otherwise wait for the few of its threads with long paths. Laine, Karras and Aila,
// "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs" (2013).
#ifndef PASSES_PATHS_PATH_STATE_GLSL
#define PASSES_PATHS_PATH_STATE_GLSL

#include "passes/paths/bindings.glsl"
#include "passes/paths/path.glsl"

const uint SPECULAR_ONLY = 0x80000000u;
const uint DIFFUSE_AT_X2 = 0x40000000u;
const float MAX_WAVELENGTH = 1024.0;  // in nanometers

// The index in paths_ray_queues where this view's queue of a wave begins: that of the view's first pixel, in the half
// for even or for odd waves.
uint queue_begin(uint wave_index) {
    return wave_index % 2u * (paths_ray_queues.at.length() / 2u) + element_index(uvec2(0u), camera.size);
}

void store_path_state(Path path, uint pixel_index, uint wave_index) {
    uint flags = path.bounce | path.delta_bounces << 8u | (path.specular_only ? SPECULAR_ONLY : 0u)
        | (path.diffuse_at_x2 ? DIFFUSE_AT_X2 : 0u);
    if (SCENE_DISPERSION) { flags |= pack_unorm(path.walk.wavelength / MAX_WAVELENGTH, 14u) << 16u; }
    uint queue_index = atomicAdd(paths_queues.at[view_index].queued, 1u);
    paths_ray_queues.at[queue_begin(wave_index) + queue_index] = pixel_index;
    paths_states.at[pixel_index] = PathState(
        path.rng, flags, apply_first_weight(path, vec3(1.0)), path.walk.throughput, path.walk.direction,
        path.hit.instance, path.hit.triangle, path.hit.barycentrics, path.sum_of_inverse_pdfs, path.footprint,
        path.walk.cone_width, path.walk.medium
    );
}

// A path as store_path_state has left it, but with no light, since what it had found is already in the pixel, and
// without its vertex: `arrive` with `resumed` makes that again from the hit.
Path load_path_state(uint pixel_index) {
    PathState state = paths_states.at[pixel_index];
    Path path = start_path(state.rng);
    path.bounce = state.flags & 0xFFu;
    path.delta_bounces = state.flags >> 8u & 0xFFu;
    path.diffuse_at_x2 = (state.flags & DIFFUSE_AT_X2) != 0u;
    path.specular_only = (state.flags & SPECULAR_ONLY) != 0u;
    if (SCENE_DISPERSION) { path.walk.wavelength = unpack_unorm(state.flags >> 16u, 14u) * MAX_WAVELENGTH; }
    path.first_weight = state.attenuated_first_weight;
    path.walk.throughput = state.throughput;
    path.walk.direction = state.direction;
    path.walk.delta_path_from_camera = path.bounce == path.delta_bounces;
    // t has been used already, and resolve_surface_interaction finds the side of the surface again.
    path.hit = Hit(0.0, state.instance, state.triangle, state.barycentrics, false);
    path.sum_of_inverse_pdfs = state.sum_of_inverse_pdfs;
    path.footprint = state.footprint;
    path.walk.cone_width = state.cone_width;
    if (SCENE_ABSORPTION) { path.walk.medium = state.medium; }
    return path;
}

#endif
