// Whose samples a pixel may reuse: one pixel of the last frame, found by motion and shuffled by a permutation (Wyman and
// Panteleev, "Rearchitecting Spatiotemporal Resampling for Production", 2021), and one nearby pixel of this frame.
#ifndef PASSES_REUSE_GLSL
#define PASSES_REUSE_GLSL

#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"

const uint PERMUTATION_SALT = 0x5BD1E995u;

// Swaps pixels within blocks of 4x4 that lie elsewhere in every frame: its own inverse, and never out of the picture.
// Differs from Solari: a pixel whose partner would lie outside keeps its place, where theirs are clamped to the edge.
ivec2 permute_pixel(ivec2 pixel, uint random) {
    ivec2 shift = ivec2(random & 3u, random >> 2u & 3u);
    ivec2 partner = ((pixel + shift) ^ 3) - shift;
    bool inside = all(greaterThanEqual(partner, ivec2(0))) && all(lessThan(partner, ivec2(camera.size)));
    return inside ? partner : pixel;
}

// Choosing by surfaces alone, never by the samples found there, is what keeps reuse unbiased.
bool find_temporal_neighbor(uvec2 pixel, GBufferSurface surface, out uvec2 neighbor, out GBufferSurface neighbor_surface) {
    ivec2 previous_pixel = ivec2(floor(reproject(pixel)));
    bool inside = all(greaterThanEqual(previous_pixel, ivec2(0))) && all(lessThan(previous_pixel, ivec2(camera.size)));
    if (this_frame.has_history == 0u || !surface.exists || !inside) { return false; }
    if (reuse_settings.permutation_sampling != 0u) {
        uint random = seed_rng(uvec2(0u), this_frame.index, this_frame.seed ^ PERMUTATION_SALT);
        neighbor = uvec2(permute_pixel(previous_pixel, random));
        neighbor_surface = load_previous_gbuffer(neighbor);
        if (are_similar(surface, neighbor_surface)) { return true; }
    }
    // Differs from Solari: where the partner shows another surface, the pixel itself still serves. Without, histories end
    // at edges, and the permutation carries their ends far into surfaces.
    neighbor = uvec2(previous_pixel);
    neighbor_surface = load_previous_gbuffer(neighbor);
    return are_similar(surface, neighbor_surface);
}

bool find_spatial_neighbor(
    uvec2 pixel, GBufferSurface surface, float radius, inout uint rng, out uvec2 neighbor, out GBufferSurface neighbor_surface
) {
    if (!surface.exists) { return false; }
    for (uint i = 0u; i < reuse_settings.spatial_tries; i++) {
        ivec2 other = ivec2(floor(vec2(pixel) + 0.5 + radius * sample_disk(rand_vec2f(rng))));
        bool inside = all(greaterThanEqual(other, ivec2(0))) && all(lessThan(other, ivec2(camera.size)));
        if (inside && other != ivec2(pixel)) {
            neighbor = uvec2(other);
            neighbor_surface = load_gbuffer(neighbor);
            if (are_similar(surface, neighbor_surface)) { return true; }
        }
        radius *= reuse_settings.spatial_radius_halving != 0u ? 0.5 : 1.0;
    }
    return false;
}

#endif
