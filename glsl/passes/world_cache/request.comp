// World cache, before each round of the fill: asks for the cells of what rays meet that leave the surfaces of pixels
// without a history, so that the paths of these pixels find light there. One pixel of each square asks. New cells are
// added to the list of active cells.
#version 460
#include "generated/passes/world_cache.glsl"  // FILL_SQUARE, written by solari_vk/passes/world_cache.py
#include "passes/denoise/api.glsl"
#include "passes/paths/reservoir.glsl"  // make_vertex
#include "passes/world_cache/query.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(constant_id = fill_rounds_id) const uint fill_rounds = 0u;

const uint PASS_SALT = 0x510E527Fu;

// Whether begin_round.comp has decided to fill the cache; in the first round it is yet to.
bool may_fill() {
    bool first = world_cache_dispatch.rounds_left == fill_rounds + 1u;
    return first || world_cache_counters.active_cells > world_cache_dispatch.old_cells;
}

bool is_new(uint index) {
    return this_frame.has_history == 0u || (uses_denoiser(index) && history_length(index) < 1.0);
}

void ask_for_cell(SurfaceInteraction surface, inout uint rng) {
    if (has_no_cell(surface.material)) { return; }
    float cell_size = get_cell_size(surface.world_position, rng);
    bool is_new;
    uint cell =
        find_or_insert_cell(surface.world_position, surface.geometric_world_normal, cell_size, is_new, rng);
    if (cell == NO_INDEX) { return; }
    if (world_cache_irradiance.at[cell].w == 0.0) { atomicAdd(world_cache_dispatch.misses, 1u); }
    atomicMax(world_cache_life.at[cell], world_cache_settings.lifetime);
    if (is_new) { world_cache_active_cells.at[atomicAdd(world_cache_counters.active_cells, 1u)] = cell; }
}

void main() {
    uvec2 square = INVOCATION_INDEX;
    if (frame_settings.world_cache == 0u || !may_fill()) { return; }
    uint rng = seed_rng(square, all_views.index, all_views.seed ^ PASS_SALT + world_cache_dispatch.rounds_left);
    uvec2 pixel = square * FILL_SQUARE + uvec2(rand_range_u(FILL_SQUARE, rng), rand_range_u(FILL_SQUARE, rng));
    uint index;
    if (!find_pixel(pixel, index) || !is_new(index)) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    if (!surface.exists) { return; }
    Vertex vertex = make_vertex(surface);
    BrdfSample next = sample_brdf(vertex.brdf, vertex.wo, rand_f(rng), rand_vec2f(rng));
    Walk walk = start_walk(vertex.position, vec3(0.0));
    walk.medium = vertex.above;
    if (!scatter(walk, next, vertex.frame, vertex.geometric_normal, vertex.lift, vertex.below)) { return; }
    walk.origin = ray_origin(vertex, walk.direction);
    SpecularChainHit found = trace_specular_chain(walk, rng);
    if (found.exists) { ask_for_cell(found.surface, rng); }
}
