// World cache, step 5: what other surfaces reflect to active cells, by one ray, at whose end the cache is asked for what it
// knew in the last frame: so that light goes one bounce further with every frame.
#version 460
#include "passes/ray_count.glsl"
#include "passes/world_cache/query.glsl"
#include "passes/world_cache/update.glsl"

layout(local_size_x = 64) in;

void main() {
    uint thread = thread_index(INVOCATION_INDEX);
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    uint rng = seed_cell_rng(cell, INDIRECT_SALT);
    WorldCacheSurface surface = load_world_cache_surface(cell);
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    vec3 direction = orthonormalize(surface.geometric_world_normal) * sample_cosine_hemisphere(rand_vec2f(rng));
    // textures are blurred as far as the cell is wide, which its points even out anyway
    float cell_size = world_cache_bounds.at[cell].w;
    uint lifetime = world_cache_samples.at[thread].life;
    Gathered light = gather_light(
        origin, direction, world_cache_settings.ray_length, cell_size, false, lifetime, rng
    );
    world_cache_samples.at[thread].irradiance += PI * gathered_radiance(light);  // cosine and pdf leave pi
}
