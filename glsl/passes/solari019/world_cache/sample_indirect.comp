// World cache, step 5: indirect light of active cells, by one ray whose hit queries the cache for its value of the
// previous frame, so that light travels one bounce further each frame.
#version 460
#include "passes/world_cache/query.glsl"
#include "passes/world_cache/update.glsl"

layout(local_size_x = GROUP_SIZE) in;

const uint PASS_SALT = 0x7C01D14Eu;

void main() {
    uint thread = thread_index(INVOCATION_INDEX);
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    uint rng = seed_cell_rng(cell, PASS_SALT);
    WorldCacheSurface surface = load_world_cache_surface(cell);
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    vec3 direction = orthonormalize(surface.geometric_world_normal) * sample_cosine_hemisphere(rand_vec2f(rng));
    Walk walk = start_walk(origin, direction);
    walk.medium = find_medium(origin);
    walk.t_max = world_cache_settings.ray_length;
    walk.cone_width = world_cache_bounds.at[cell].w;  // textures are filtered over the width of the cell
    uint lifetime = world_cache_samples.at[thread].life & ~SEES_WALL;
    GatheredLight light = gather_light(walk, false, lifetime, rng);
    world_cache_samples.at[thread].irradiance +=
        PI * gathered_radiance(light) * light.through.weight;  // PI is the cosine over the pdf
}
