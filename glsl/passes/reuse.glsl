// Finds the pixels whose samples a pixel reuses: one of the previous frame, by motion vectors and a permutation, and
// one nearby in this frame. Wyman and Panteleev, "Rearchitecting Spatiotemporal Resampling for Production" (2021).
#ifndef PASSES_REUSE_GLSL
#define PASSES_REUSE_GLSL

#include "common/pixel.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"

const uint PERMUTATION_SALT = 0x5BD1E995u;

// Permutes pixels within blocks of 4x4, whose grid is shifted in every frame. The permutation is its own inverse.
// Differs from Solari, which clamps partners outside the picture to its edge: a pixel with such a partner stays in
// place.
ivec2 permute_pixel(ivec2 pixel, uint random) {
    ivec2 shift = ivec2(random & 3u, random >> 2u & 3u);
    ivec2 partner = ((pixel + shift) ^ 3) - shift;
    return is_inside(partner, camera.size) ? partner : pixel;
}

// Reuse is unbiased because neighbors are chosen by their surfaces alone, never by their samples.
bool find_temporal_neighbor(
    uvec2 pixel, GBufferSurface surface, out uvec2 neighbor, out GBufferSurface neighbor_surface
) {
    ivec2 previous_pixel = ivec2(floor(reproject(pixel)));
    bool inside = is_inside(previous_pixel, camera.size);
    if (this_frame.has_history == 0u || !surface.exists || !inside) { return false; }
    if (reuse_settings.permutation_sampling != 0u) {
        uint random = seed_rng(uvec2(0u), this_frame.index, this_frame.seed ^ PERMUTATION_SALT);
        neighbor = uvec2(permute_pixel(previous_pixel, random));
        neighbor_surface = load_previous_gbuffer(neighbor);
        if (are_similar(surface, neighbor_surface)) { return true; }
    }
    // Differs from Solari: where the permuted pixel shows another surface, the reprojected pixel itself is tried.
    // Otherwise histories would end at edges, and the permutation would spread their ends over the surface.
    neighbor = uvec2(previous_pixel);
    neighbor_surface = load_previous_gbuffer(neighbor);
    return are_similar(surface, neighbor_surface);
}

bool find_spatial_neighbor(
    uvec2 pixel, GBufferSurface surface, float radius, inout uint rng, out uvec2 neighbor,
    out GBufferSurface neighbor_surface
) {
    if (!surface.exists) { return false; }
    for (uint i = 0u; i < reuse_settings.spatial_tries; i++) {
        ivec2 other = ivec2(floor(vec2(pixel) + 0.5 + radius * sample_disk(rand_vec2f(rng))));
        if (is_inside(other, camera.size) && other != ivec2(pixel)) {
            neighbor = uvec2(other);
            neighbor_surface = load_gbuffer(neighbor);
            if (are_similar(surface, neighbor_surface)) { return true; }
        }
        radius *= reuse_settings.spatial_radius_halving != 0u ? 0.5 : 1.0;
    }
    return false;
}

#endif
