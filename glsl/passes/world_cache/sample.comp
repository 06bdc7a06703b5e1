// World cache, step 4: the irradiance of active cells, by a path that starts at the cell's point as at a white diffuse
// surface. It ends in the cache's values of the previous frame, so that light travels one bounce further each frame.
// Differs from Solari: one dispatch has direct and indirect light, from one path, and rays are not cut at 50 m, which
// would darken large halls and streets.
#version 460
#include "passes/world_cache/cell_path.glsl"

layout(local_size_x = GROUP_SIZE) in;

// Whether trace.comp traces the first rays, and arrive.comp goes on, if their buffer has room.
layout(constant_id = traces_apart_id) const bool traces_apart = false;

const uint PASS_SALT = 0x7C0D14ECu;

void main() {
    uint thread = place_in_list(thread_index(INVOCATION_INDEX));
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    uint index = atomicAdd(world_cache_counters.updates, 1u);
#ifdef MANY_VIEWS
    world_index = world_cache_worlds.at[cell];
#endif
    uint rng = seed_cell_rng(cell, PASS_SALT);
    WorldCacheSurface surface = load_world_cache_surface(cell);

    vec3 normal = surface.geometric_world_normal;
    Path path = start_path(rng);
    path.vertex = make_vertex(surface.world_position, normal, surface.ray_offset, 0.0, normal, normal);
    path.vertex.brdf = lambert_brdf(vec3(1.0));
    path.walk.medium = path.vertex.above = find_medium(path.vertex.origin);
    path.candidates = world_cache_settings.candidates;
    path.lobe_u = rand_f(path.rng);
    path.u = rand_vec2f(path.rng);
    path.walk.cone_width = world_cache_bounds.at[cell].w;  // textures are filtered over the width of the cell
    path.cache_lifetime = world_cache_samples.at[thread].life & ~SEES_WALL;  // a round of the fill may have set it
    world_cache_samples.at[thread].irradiance = vec3(0.0);
    do {
        choose_rays(path);
        if (traces_apart && paths_have_room() && index < world_cache_paths.at.length()) {
            world_cache_paths.at[index].thread = thread;
            store_cell_path(path, index);
            return;
        }
    } while (add_rays(path, trace_rays(path)) && arrive(path, false));
    add_to_cell(path, thread);
    test_for_wall(cell, thread);
}
